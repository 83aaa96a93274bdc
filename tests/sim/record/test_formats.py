"""Records of every format that there has been are read for ever; later ones are refused. See CHANGELOG.md."""

from pathlib import Path

import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import FORMAT, FORMAT_KEY, BagReader, BagWriter
from litsim_sim.record.run import read_run

BAGS = Path(__file__).with_name("bags")
"""One record of each format, made by the launcher then: short-idm-litsim of tests/graph/conftest.py."""


def test_there_is_a_record_of_each_format() -> None:
    assert {path.name for path in BAGS.iterdir()} == {f"format_{version}" for version in range(1, FORMAT + 1)}
    for version in range(1, FORMAT + 1):
        assert BagReader(BAGS / f"format_{version}").metadata[FORMAT_KEY] == str(version)


def test_format_1_is_read() -> None:
    run = read_run(BAGS / "format_1")
    assert run.complete and not any(run.gaps.values())
    assert run.info.run_id.startswith("short-idm-litsim-13-0-fdc3ef0b@")
    assert set(run.info.stages) == {"recorder", "predictor", "conflict", "policy", "ego"}
    assert [table.step for table in run.tables] == list(range(36))
    assert {len(table) for table in run.tables} == {40} and len(run.log) == 36
    assert set(run.controls) == set(run.ego_commands) == set(run.takeovers) == set(range(36))
    assert sorted({each.agent for listed in run.takeovers.values() for each in listed}) == [12]
    metrics = compute_metrics(run)
    assert (metrics["valid"], metrics["why"], metrics["steps"], metrics["agents"]) == (True, "", 35, 39)
    assert metrics["digest"].startswith("593e40be30c53d6c")
    assert metrics["takeovers"] == 1


def written(folder: Path, **metadata: str) -> Path:
    with BagWriter(folder, "run") as writer:
        writer.add_metadata("run", metadata)
    return folder / "run_0.mcap"


@pytest.mark.parametrize("version", [str(FORMAT + 1), "1000", "-1", "", "one", "1.5"])
def test_what_is_of_a_later_format_is_refused(tmp_path: Path, version: str) -> None:
    path = written(tmp_path, **{FORMAT_KEY: version})
    with pytest.raises(InputError) as raised:
        BagReader(path)
    assert str(raised.value).startswith(f"{path}: a record of format {version!r}, expected at most {FORMAT}; ")


def test_what_says_no_format_or_an_earlier_one_is_read(tmp_path: Path) -> None:
    for number, metadata in enumerate([{}, {FORMAT_KEY: "1"}, {FORMAT_KEY: str(FORMAT)}]):
        assert BagReader(written(tmp_path / str(number), **metadata)).complete
