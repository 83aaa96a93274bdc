"""One case run: in process as it would be alone, over DDS by the launcher; whatever becomes of it is told."""

import json
import os
from pathlib import Path
from typing import Any

import pytest

import campaigns
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.campaign.criteria import Verdict
from litsim_eval.runs import case_run
from litsim_eval.runs.case_run import RunStopped, check_case, run_in_process, run_over_graph
from litsim_eval.runs.in_process import record
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import setting
from litsim_sim.record.failure import read_failure
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

EXTERNAL = {"name": "mine", "kind": "external", "command": ["my_stack", "--fast"], "interface": "twist", "ready_s": 30}
ELSEWHERE = {name: value for name, value in EXTERNAL.items() if name != "command"}


def case(ego: Any = "log", ego_id: int = 7, policy: str = "replay", **fields: Any) -> Any:
    road = [{"scenario": "demo", "ego_id": ego_id}]
    (made,) = campaigns.cases(egos=[ego], cases=road, policies=[policy], **fields)
    return made


def test_a_case_is_run_without_sumo_and_measured() -> None:
    found = run_in_process(case())
    assert found["valid"] and found["collision"]["excess"] == 0 and found["policy"] == "replay"
    assert found["world"]["sumo_deviation_m"] is None


def test_a_case_is_the_run_of_its_own_scenario_whatever_was_run_before() -> None:
    cases = [case("idm", 3), case("idm", 3, seeds=[5]), case()]
    found = [run_in_process(each) for each in cases]
    for each, metrics in zip(cases, found, strict=True):
        scenario = Scenario.load("demo", ego=each.ego_id, seed=each.seed)
        alone = compute_metrics(record(RunPlan(scenario, each.ego.kind, each.policy)))
        assert (metrics["digest"], metrics["run_id"]) == (alone["digest"], alone["run_id"])
        assert metrics["ledger"] == alone["ledger"] and metrics["safety"] == alone["safety"]
    assert len({metrics["run_id"] for metrics in found}) == len(cases)


def test_parameters_of_variant_and_ego_reach_the_run() -> None:
    own = {"name": "braker", "kind": "perturbed", "parameters": {"ego.kind": "brake", "ego.time": [0.0, 0.0]}}
    found = run_in_process(case(own, 3, parameters={"ego.deceleration": [3.0]}))
    settings = [("ego", "kind", "brake"), ("ego", "time", (0.0, 0.0)), ("ego", "deceleration", 3.0)]
    plan = RunPlan.load("demo", "perturbed", "replay", ego_id=3, settings=settings)
    assert (found["run_id"], found["digest"]) == (plan.run_id, compute_metrics(record(plan))["digest"])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"ego": {"name": "a", "kind": "idm", "parameters": {"ego.hurry": 1}}}, "ego: unknown parameter hurry"),
        ({"policy": "yield", "parameters": {"conflict.horizon": [-1]}}, "conflict: parameter horizon is -1"),
        ({"ego": EXTERNAL}, "my_stack: no such program"),
        ({"ego": EXTERNAL | {"parameters": {"bridge.patience": 1}}}, "bridge: unknown parameter patience"),
    ],
)
def test_what_can_be_known_of_a_case_is_checked_before_it_is_run(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_case(case(**changes))


@pytest.fixture
def launcher(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Puts a shell script in the place of the launcher; in it, `out` is the folder of the recording."""

    def put(script: str) -> Path:
        path = tmp_path / "launch"
        folder = 'printf "%s\\n" "$@" > words\nwhile [ $# -gt 0 ]; do [ $1 = --out ] && out=$2; shift; done'
        shell = f"cd {tmp_path}\n{folder}\nmkdir -p $out/log\n{script}\n"
        path.write_text(f"import os, sys\nos.execv('/bin/sh', ['sh', '-c', {shell!r}, *sys.argv])")
        monkeypatch.setattr(case_run, "find_executable", lambda *_: path)
        return tmp_path

    return put


def over_graph(made: Any, folder: Path, **how: Any) -> Any:
    (folder / "case").mkdir()
    return run_over_graph(made, folder / "case", **how)


def test_over_dds_a_run_is_measured_and_its_files_are_named(launcher: Any) -> None:
    metrics = campaigns.metrics()
    folder = launcher(
        f"echo '{json.dumps(metrics)}' > $out/metrics.json; cd $out; touch a.mcap report.html log/ads.log"
    )
    made = case(EXTERNAL | {"parameters": {"bridge.answer_timeout_s": 9.5}}, seeds=[4], end_after_contact_s=0.5)
    found = over_graph(made, folder)
    assert (found.metrics, found.failure) == (metrics, "")
    assert (found.recording, found.report, found.log) == ("run", "run/report.html", "run/log/ads.log")
    words = (folder / "words").read_text().split("\n")
    line = " ".join(words)
    assert f"--case {folder / 'case'} " in line
    assert "--scenario demo --ego external --policy replay --ego-id 7 --ego-interface twist" in line
    assert "--seed 4 --end-after-contact 0.5" in line
    assert "--set bridge.answer_timeout_s=9.5 bridge.external_timeout_s=30.0 -- my_stack --fast" in line


def test_small_numbers_reach_the_launcher_as_numbers(launcher: Any) -> None:
    folder = launcher(f"echo '{json.dumps(campaigns.metrics())}' > $out/metrics.json")
    over_graph(case("idm", policy="yield", parameters={"conflict.urgent_time": [0.00001]}), folder)
    words = (folder / "words").read_text().split("\n")
    assert setting(words[words.index("--set") + 1]) == ("conflict", "urgent_time", [0.00001])


@pytest.mark.parametrize(
    ("script", "failure"),
    [
        ("echo first >&2; echo 'error: node policy ended' >&2; echo last >&2; exit 1", "node policy ended"),
        ("echo first >&2; exit 1", "first"),
        ("exit 1", "the launcher ended with exit status 1"),
        ("kill -9 $$", "the launcher was ended by SIGKILL"),
    ],
)
def test_over_dds_a_run_that_fails_is_said_to(launcher: Any, script: str, failure: str) -> None:
    found = over_graph(case("idm"), launcher(f"touch $out/log/ads.log; {script}"))
    assert (found.metrics, found.failure, found.log, found.report) == (None, failure, "run/log/ads.log", None)
    result = found.judged(case("idm"), campaigns.CRITERIA)
    assert (result.verdict, result.reason, result.log) == (Verdict.ERROR, failure, "run/log/ads.log")


def test_over_dds_a_run_that_is_not_valid_keeps_its_measures(launcher: Any) -> None:
    found = over_graph(case("idm"), launcher("""echo '{"valid": false, "why": "gaps"}' > $out/metrics.json; exit 1"""))
    result = found.judged(case("idm"), campaigns.CRITERIA)
    assert (result.verdict, result.reason) == (Verdict.ERROR, "the run is not valid: gaps")
    assert result.metrics == {"valid": False, "why": "gaps"}


def test_a_launcher_that_does_not_come_back_is_ended(launcher: Any) -> None:
    folder = launcher("touch $out/a_0.mcap; exec sleep 600")
    assert over_graph(case("idm"), folder, time_limit_s=0.5).failure == "time limit of 0.5 s exceeded"
    assert read_failure(folder / "case/run/a_0.mcap") == "time limit of 0.5 s exceeded", "the record alone cannot know"


def test_a_run_that_takes_too_long_leaves_a_report_of_what_it_recorded(launcher: Any) -> None:
    recorded = Path(__file__).parents[2] / "sim/record/bags/format_1/format_1_0.mcap"
    folder = launcher(f"cp {recorded} $out; exec sleep 600")
    found = over_graph(case("idm"), folder, time_limit_s=0.5)
    assert (found.metrics, found.report) == (None, "run/report.html")
    assert "time limit of 0.5 s exceeded" in (folder / "case/run/report.html").read_text()


def test_a_run_of_a_campaign_that_has_ended_says_nothing(launcher: Any) -> None:
    with pytest.raises(RunStopped):
        over_graph(case("idm"), launcher("exec sleep 600"), stopped=lambda: True)


def test_a_launcher_has_what_it_needs_before_it_begins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """And what its nodes need; one process has imported it for all launchers of a campaign."""
    program = tmp_path / "launch"
    program.write_text(f"""
import os, sys
with open({str(tmp_path / "told")!r}, "a") as file:
    print({case_run.PRELOADED!r} in sys.modules, "litsim_sim.nodes.bridge" in sys.modules, os.getppid(), file=file)
""")
    monkeypatch.setattr(case_run, "find_executable", lambda *_: program)
    for name in ("a", "b"):
        run_over_graph(case("idm"), tmp_path / name)
    told = [line.split() for line in (tmp_path / "told").read_text().splitlines()]
    assert [each[:2] for each in told] == [["True", "True"]] * 2
    assert told[0][2] == told[1][2] != str(os.getpid())


@pytest.mark.parametrize(("ego", "domain"), [("idm", ""), (EXTERNAL, ""), (ELSEWHERE, "77")])
def test_only_a_stack_that_runs_already_is_met_in_its_own_domain(
    launcher: Any, monkeypatch: pytest.MonkeyPatch, ego: Any, domain: str
) -> None:
    monkeypatch.setitem(os.environ, "ROS_DOMAIN_ID", "77")
    folder = launcher("echo $ROS_DOMAIN_ID > domain; exit 1")
    over_graph(case(ego), folder)
    assert (folder / "domain").read_text().strip() == domain
