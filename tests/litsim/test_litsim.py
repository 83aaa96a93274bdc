"""What is imported from Python: the example of the page, campaigns and recorded runs."""

import re
from pathlib import Path
from textwrap import dedent
from typing import Any

import matplotlib as mpl
import pytest

import litsim
from documentation import ROOT
from litsim_sim.core.errors import InputError

EXAMPLE = dedent(re.search(r"::\n\n(.*?)\n\nA step", litsim.__doc__ or "", re.DOTALL)[1])
CASES = [{"scenario": "demo", "ego_id": "ego"}]


def test_the_example_plots_who_is_under_control(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mpl.use("Agg")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(EXAMPLE, names)
    assert max(names["controlled"]) > 0 and Path("controlled.png").stat().st_size > 1000


def test_the_readme_has_the_same_example() -> None:
    assert f"```python\n{EXAMPLE}\n```" in (ROOT / "README.md").read_text()


def test_the_example_of_the_reference_drives_the_ego_and_runs_a_campaign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/api.md").read_text(), re.DOTALL)
    exec(block, {})
    assert capsys.readouterr().out == "0 contacts\nTrue\n"


def test_a_campaign_is_run_and_resumed(tmp_path: Path) -> None:
    suite = {"name": "mine", "cases": CASES, "egos": ["idm"], "policies": ["replay", "yield"]}
    campaign = litsim.evaluate(suite, tmp_path / "mine", processes=1)
    excess = {name: results[0].metrics["collision"]["excess"] for name, results in campaign.variants.items()}
    assert len(excess) == 2 and min(excess.values()) == 0 < max(excess.values())
    assert litsim.evaluate(suite, tmp_path / "mine", processes=1).results == campaign.results


def test_a_suite_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nobody"):
        litsim.evaluate({"name": "mine", "cases": CASES, "egos": ["nobody"]}, tmp_path)
    with pytest.raises(InputError, match="cases"):
        litsim.evaluate({"name": "mine", "egos": ["idm"]}, tmp_path)


def test_a_recorded_run_is_loaded() -> None:
    run = litsim.load_run(ROOT / "tests/sim/record/bags/format_1")
    assert run.info.scenario and len(run.tables) > 1
