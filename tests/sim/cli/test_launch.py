"""What the launcher refuses; what it and its nodes have to import before the first step, which waits for all of it."""

import subprocess
import sys
from pathlib import Path

import pytest

from command_line import refusal, status
from litsim_eval.campaign.suite import CAMPAIGN_FILE
from litsim_sim.cli import launch
from litsim_sim.cli.launch import main
from litsim_sim.launch.processes import GraphFailed
from litsim_sim.record.bag import FAILURE_FILE

COMPILER = "numba.np.arraymath"  # which numba imports before it compiles anything
NOT_NEEDED = ("matplotlib", "onnxruntime", "pandas", "scipy.linalg", "scipy.sparse", "scipy.special", "torch", COMPILER)
CHECK = f"""
import sys
from pathlib import Path
from litsim_sim.cli import launch
from litsim_sim.launch.nodes import nodes_of
from litsim_sim.nodes.shared import prepare_nodes
arguments = launch.parser().parse_args(["--ego", "idm", "--policy", "litsim"])
plan = launch.plan_of(arguments)
nodes_of(plan, arguments.scenario, Path("out"))
plan.scenario.recording.parquet
prepare_nodes()
import litsim_policy.driving.stages_node, litsim_policy.ego.node, litsim_sim.nodes.recorder
print(*[name for name in {NOT_NEEDED} if name in sys.modules])
"""


def test_neither_the_launcher_nor_its_nodes_import_a_library_that_they_do_not_need() -> None:
    done = subprocess.run([sys.executable, "-c", CHECK], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr


def errors(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """The errors that were printed; kernels of other tests may be compiled as well."""
    return [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--policy", "nice"), "argument --policy: invalid choice: 'nice' (choose from "),
        (("--answer-timeout", "0"), "argument --answer-timeout: '0', expected a number of more than 0"),
        (("--vehicle", "delay_s=0.25"), "argument --vehicle: delay_s=0.25: delay_s is 0.25, expected a multiple of "),
        (("--ego-interface", "twist"), "error: --ego-interface twist: the ego is idm, expected --ego external"),
        (("--vehicle", "wheels=4"), "argument --vehicle: wheels=4: wheels is unknown, expected some of "),
        (
            ("--policy", "replay", "--set", "policy.weights=mine"),
            "error: no stage of this run: policy; expected bridge, ",
        ),
        (("--", "true"), "the ego is idm, expected --ego external"),
        (("--scenario", "none.yaml"), "none.yaml: no such scenario; expected a YAML file, or one of demo"),
        (("--ego-id", "4711"), "field ego: no vehicle 4711"),
        (("--domain-id", "233"), "error: ROS_DOMAIN_ID is '233', expected 0 to 232"),
        (
            ("--ego", "external", "--", "no_such_stack"),
            "no_such_stack: no such program, expected the command that starts",
        ),
    ],
)
def test_options_that_are_wrong(
    words: tuple[str, ...],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refusal(capsys, main, *words).splitlines()[-1]
    assert not list(tmp_path.iterdir()), "nothing is left behind"


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_no_run_is_recorded_into_the_folder_of_a_campaign(
    more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / CAMPAIGN_FILE).write_text("{}")
    assert status(main, "--out", tmp_path, *more) == 2
    said = f"error: {tmp_path}: the folder of a campaign, expected one of a run; give another --out"
    assert errors(capsys) == [said]
    assert [path.name for path in tmp_path.iterdir()] == [CAMPAIGN_FILE]


def test_a_run_that_has_failed_ends_so_where_its_reason_cannot_be_written_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object) -> None:
        (tmp_path / "out" / FAILURE_FILE).mkdir()  # nothing can be written in its place
        raise GraphFailed("the disk is full")

    monkeypatch.setattr(launch, "_run", fails)
    assert (
        status(launch.main, "--ego", "log", "--policy", "replay", "--out", tmp_path / "out", "--no-analyze", "--quiet")
        == 1
    )
    assert errors(capsys) == [f"error: the disk is full (logs: {tmp_path / 'out' / 'log'})"]
