"""metrics.json: its fields, when a run is valid, and the command that prints it."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import litsim_sim
from command_line import refusal, status
from litsim_eval.analysis.measures.identity import digest
from litsim_eval.analysis.measures.lockstep import problems
from litsim_eval.analysis.measures.timing import timing
from litsim_eval.analysis.metrics import compute_metrics, find_field, leaves, metric_fields, write_metrics
from litsim_eval.cli.analyze import main
from litsim_eval.report.analyze import FILES, measure
from litsim_eval.report.terminal import print_ledger, print_metrics
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Controller, ControlSource, ControlTable
from litsim_sim.core.stages import StageState
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.failure import write_failure
from litsim_sim.record.run import Status, TopicGaps, read_run
from litsim_sim.record.seal import write_seal
from litsim_sim.scenario.mission import Mission
from litsim_sim.scenario.signals import Signals
from made_agents import takeover
from made_runs import make_run, moved, table, write_run

NET = Path(litsim_sim.__file__).parent / "nets/us101_like.net.xml"
HISTORY, STEPS = 10, 60


@pytest.fixture
def run() -> Any:
    """The ego slower than its log by up to 10 m, agent 2 behind it under control half of the time; agent 3 logged."""
    rows = {1: (40.0, -1.83), 2: (20.0, -1.83), 3: (30.0, -5.49)}
    log = [table(k, *({"id": a, "x": x + k, "y": y} for a, (x, y) in rows.items())) for k in range(STEPS + 1)]
    tables = []
    for k, each in enumerate(log):
        late = max(0.0, 0.2 * (k - HISTORY))
        out = moved([each], 1, x=-late, controller=Controller.EGO if k >= HISTORY else Controller.LOG)
        tables += moved(out, 2, x=-5.0, controller=Controller.POLICY) if 20 < k <= 40 else out
    times = {"policy": dict.fromkeys(range(STEPS + 1), 0.002) | {0: 3.0}}
    return make_run(tables, log, history_steps=HISTORY, timing=times, net_xml=NET.read_bytes())


def test_measures_of_a_run(run: Any) -> None:
    metrics = json.loads(json.dumps(compute_metrics(run), allow_nan=False))
    assert metrics["steps"] == STEPS
    assert metrics["agents"] == 2
    assert metrics["controlled_agents"] == 1
    assert metrics["valid"], metrics["why"]
    assert metrics["why"] == ""
    assert metrics["reactive"]
    assert metrics["ade_all_m"] == {"5": pytest.approx(5.0 * 20 / 100)}
    assert metrics["ade_ego_m"]["5"] == pytest.approx(0.2 * 25.5)
    assert metrics["handback"]["count"] == 1
    assert metrics["handback"]["max_position_jump_m"] == pytest.approx(5.0)
    assert metrics["collision"]["rate_all"] == 0.0


@pytest.fixture
def whole(run: Any) -> dict[str, Any]:
    """Measures of the run with signals and a mission: of every family of measures there is one."""
    signals = Signals(("1",), (), np.empty(0, np.int64), np.zeros((1, STEPS + 1), np.uint8))
    lanes = len(LaneMap.from_net(NET).lanes)
    mission = Mission(np.zeros((2, 2)), np.zeros(3), np.ones(lanes, np.bool_), np.zeros(lanes))
    return compute_metrics(replace(run, signals=signals, mission=mission))


def test_every_leaf_of_a_run_is_a_field_of_its_kind(whole: dict[str, Any]) -> None:
    found = leaves(whole)
    assert len(found) > 80 and found["realism.score"] is not None and found["fault.of_ego"] is not None
    for name, value in found.items():
        field = find_field(name)
        assert value is None or type(value) in field.kinds | ({int} if float in field.kinds else set()), name


def test_every_field_that_a_run_must_have_is_in_it(whole: dict[str, Any]) -> None:
    of_other_runs = (
        "ade_controlled_m.",
        "ade_all_m.",
        "ade_ego_m.",
        "lockstep.",
        "timing.",
        "displacement.agent_steps.",
    )
    of_other_runs += ("realism.features.traffic_light_violation",)
    for field in metric_fields():
        if not field.name.startswith(of_other_runs):
            assert field.name in leaves(whole), field.name


def answers(run: Any) -> dict[int, ControlTable]:
    """Agent 2 by the policy, every fourth command guarded, then handed back; agent 3 is no business of a guard."""
    found = {step: ControlTable.empty(step) for step in range(STEPS + 1)}
    for step in range(20, 45):
        driven = ControlSource.GUARDED if step % 4 == 0 else ControlSource.POLICY
        source = [driven if step < 40 else ControlSource.HANDBACK, ControlSource.LATE]
        found[step] = ControlTable(step, np.array([2, 3]), *np.zeros((3, 2)), np.array(source, np.uint8))
    for step in (HISTORY - 1, STEPS):  # moves nobody after the history, or nobody at all
        found[step] = ControlTable(step, np.array([2]), *np.zeros((3, 1)), np.array([ControlSource.GUARDED], np.uint8))
    return found


@pytest.mark.parametrize(
    ("ahead", "since", "at_fault", "own"), [(3.5, 12, 1, 0.0), (3.5, 50, 1, None), (-3.5, 50, 0, None)]
)
def test_only_contacts_that_the_ego_answers_for_spoil_its_own_ttc(
    run: Any, ahead: float, since: int, at_fault: int, own: float | None
) -> None:
    """Agent 3 is put into the ego's lane, overlapping its front or its rear; or it has been ahead for long."""
    hit = []
    for each in run.tables:
        there = each.step >= since
        ego = each.x[each.row(1)]
        now = float(ego + ahead + 0.5 * max(0, 50 - each.step) - each.x[each.row(3)])
        hit.append(moved([each], 3, x=now, y=3.66, speed=-5.0)[0] if there else each)
    metrics = compute_metrics(replace(run, tables=hit))
    assert metrics["collision"]["ego_at_fault"] == at_fault and metrics["safety"]["min_ttc_s"] == 0.0
    assert metrics["safety"]["min_own_ttc_s"] == own
    excused = compute_metrics(replace(run, tables=hit, log=hit))
    assert excused["collision"]["ego_at_fault"] == excused["collision"]["background_at_fault"] == 0
    assert excused["safety"]["min_own_ttc_s"] is None and excused["fault"]["of_ego"] == 0
    assert excused["collision"]["ego_contacts"][0]["in_log"] and not metrics["collision"]["ego_contacts"][0]["in_log"]


def test_a_contact_does_not_hide_the_braking_that_it_would_have_taken_to_avoid_it(run: Any) -> None:
    """Agent 3, slower by 5 m/s, is 5 m ahead of the ego at step 49, and in contact from step 50 on."""
    hit = []
    for each in run.tables:
        now = float(each.x[each.row(1)] - each.x[each.row(3)]) + each.length[each.row(1)]
        gap = 5.0 if each.step == 49 else -1.0
        hit.append(moved([each], 3, x=now + gap, y=3.66, speed=-5.0)[0] if each.step >= 49 else each)
    assert compute_metrics(replace(run, tables=hit))["safety"]["max_drac_mps2"] == pytest.approx(2.5)


def test_hard_brakes_count_where_somebody_drives(run: Any) -> None:
    """Agent 2 is under control at steps 21 to 40, and brakes once before, once then, and once after that."""

    def braking(tables: list[Any], steps: set[int]) -> list[Any]:
        return [moved([t], 2, acceleration=-4.0)[0] if t.step in steps else t for t in tables]

    found = compute_metrics(
        replace(run, tables=braking(run.tables, {5, 15, 30, 50}), log=braking(run.log, {25, 35, 45}))
    )
    assert found["comfort"]["controlled"]["hard_brakes"] == 1
    assert found["comfort"]["controlled"]["hard_brakes_log"] == 2


def test_guarded_commands_show(run: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert compute_metrics(run)["comfort"]["controlled"]["guarded"] == {"count": 0, "commands": 0, "share": None}
    guarded = compute_metrics(replace(run, controls=answers(run)))
    assert guarded["comfort"]["controlled"]["guarded"] == {"count": 5, "commands": 20, "share": 5 / 20}
    print_metrics(guarded)
    assert re.search(r"guarded steps of policy C +25\.0 %", capsys.readouterr().out)


def test_the_terminal_tells_of_an_ego_that_is_too_slow(
    run: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    for seconds, told in ((0.25, True), (0.05, False)):
        print_metrics(compute_metrics(replace(run, timing={"ego": dict.fromkeys(range(STEPS + 1), seconds)})))
        assert ("too slow for 10 Hz" in capsys.readouterr().out) == told


def test_the_ledger_shows_contacts_and_takeovers(
    run: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "240")
    print_ledger(compute_metrics(run), 1)
    assert capsys.readouterr().out == ""  # nothing happened
    hit = [t if t.step < 50 else moved([t], 3, y=3.66)[0] for t in run.tables]  # into the ego from behind
    metrics = compute_metrics(replace(run, tables=hit))
    taken = {"agent": 2, "opponent": 1, "reason": "conflict", "detected_step": 21, "released_step": 40, "held_s": 2.0}
    taken |= {"time_to_conflict_s": 1.5, "overlap_probability": 0.4, "residual_m": 5.0, "false_alarm": False}
    taken |= {"outcome": "back_on_log"}
    unpredicted = {"reason": "blocked_entry", "time_to_conflict_s": None, "overlap_probability": None}
    metrics["ledger"] = [
        taken | {"replay_would_collide": True, "replay_step": 36, "replay_opponent": 1},
        taken
        | unpredicted
        | {"released_step": None, "outcome": "own_intent", "own_intent_step": 44, "replay_would_collide": False},
    ]
    print_ledger(metrics, 1)
    lines = [re.sub("  +", "|", line.strip()) for line in capsys.readouterr().out.splitlines()]
    assert [line for line in lines if line.startswith("ego 1|3|5.0 s|no|rear: the ego does not answer for it; 3 ran")]
    assert "2|ego 1|conflict|2.1 s|in 1.5 s, p = 0.40|hits ego 1 at 3.6 s|2.0 s|4.0 s|5.00 m" in lines
    assert "2|ego 1|blocked entry|2.1 s|–|no contact|2.0 s|own intent from 4.4 s|–" in lines


FINISHED = Status(STEPS, "bridge", StageState.FINISHED, 3.0, "missed: {/litsim/controls: 2}\n")
FAILED = Status(30, "bridge", StageState.FAILED, 0.0, "no answer to step 30\n")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"complete": False, "problem": "cut short at byte 7"}, "the recording is cut short at byte 7"),
        ({"statuses": []}, "the bridge did not finish: last step 60 of 60"),
        ({"statuses": [FINISHED]}, "2 answers missed on /litsim/controls"),
        ({"statuses": [FAILED]}, "bridge failed: no answer to step 30"),
        ({"statuses": [FINISHED, replace(FINISHED, text="missed: {}\n")]}, "two different last messages of the"),
        ({"gaps": {"/clock": TopicGaps(missing=(3, 4))}}, "/clock: 2 steps missing (first 3)"),
        ({"gaps": {"/clock": TopicGaps(duplicated=(5,))}}, "/clock: 1 steps duplicated (first 5)"),
        ({"log": []}, "the bag holds no recording"),
    ],
)
def test_runs_that_are_not_valid(run: Any, change: dict[str, Any], why: str) -> None:
    metrics = compute_metrics(replace(run, **change))
    assert not metrics["valid"]
    assert why in metrics["why"]
    json.dumps(metrics, allow_nan=False)


def test_what_follows_the_end_of_a_run_that_did_not_finish_is_not_told(run: Any) -> None:
    cut, log = ([table for table in tables if table.step <= 40] for tables in (run.tables, run.log))
    gaps = {"/clock": TopicGaps(missing=(7, *range(41, STEPS + 1)))}
    why = compute_metrics(replace(run, tables=cut, log=log, statuses=[], gaps=gaps))["why"]
    assert why.endswith(f"the bridge did not finish: last step 40 of {STEPS}; /clock: 1 steps missing (first 7)")


def test_a_run_is_judged_against_its_seal(run: Any, tmp_path: Path) -> None:
    folder = write_run(run, tmp_path / "bag")
    recorded = read_run(folder)
    facts = recorded.facts(digest(recorded))
    write_seal(folder, facts)
    assert "sealed" not in compute_metrics(read_run(folder))["why"]
    write_seal(folder, replace(facts, step=STEPS + 9))
    assert f"step is {STEPS}, sealed is {STEPS + 9}" in compute_metrics(read_run(folder))["why"]


def test_states_that_are_not_finite_are_not_valid(run: Any) -> None:
    broken = [t if t.step < 55 else moved([t], 3, speed=float("nan"))[0] for t in run.tables]
    metrics = compute_metrics(replace(run, tables=broken))
    assert "not finite at 6 steps (first 55)" in metrics["why"]


def test_times_leave_out_the_first_step(run: Any) -> None:
    times = timing(run)
    assert times["wall_s"] == 2.0
    assert times["realtime_factor"] == pytest.approx(3.0)
    assert times["stage_ms"]["policy"]["max"] == pytest.approx(2.0)
    assert timing(replace(run, statuses=[]))["realtime_factor"] is None
    assert problems(run) == []


def test_analyze_writes_beside_the_bag_and_prints(run: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_run(run, tmp_path / "bag")
    metrics = measure(read_run(folder), folder)
    assert json.loads((folder / "metrics.json").read_text()) == metrics
    header = (folder / "overview.png").read_bytes()[:24]
    assert header[:4] == b"\x89PNG"
    assert int.from_bytes(header[16:20], "big") == 1600
    with pytest.raises(SystemExit, match="1"):  # the bag holds no answers of stages
        main([str(folder / "run_0.mcap"), "--out", str(tmp_path / "else/where")])
    assert {path.name for path in (tmp_path / "else/where").iterdir()} == set(FILES)
    assert json.loads((tmp_path / "else/where/metrics.json").read_text()) == metrics
    assert (tmp_path / "else/where/overview.png").stat().st_size > 20_000
    out = capsys.readouterr().out
    assert "ADE@5 s, all" in out
    assert metrics["digest"][:16] in out
    with pytest.raises(SystemExit, match="1"):
        main([str(folder), "--quiet"])
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("text", "failure"),
    [
        ("interrupted", "the stack (mine) ended with exit status 1: ValueError: lost"),
        ("no answer to step 60", "no answer to step 60; the stack (mine) was running"),
    ],
)
def test_what_the_launcher_knows_comes_first_and_nothing_is_told_twice(
    run: Any, tmp_path: Path, text: str, failure: str
) -> None:
    failed = Status(STEPS, "bridge", StageState.FAILED, 0.0, text)
    folder = write_run(replace(run, statuses=[failed]), tmp_path / "bag")
    assert f"bridge failed: {text}; " in compute_metrics(read_run(folder))["why"]
    write_failure(folder, failure)
    metrics = compute_metrics(read_run(folder))
    assert not metrics["valid"]
    assert metrics["why"].startswith(f"{failure}; the bridge did not finish: last step 60 of 60; ")
    assert "bridge failed" not in metrics["why"]


def test_a_run_that_is_not_valid_is_measured_and_said_to_be(
    run: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failed = Status(STEPS, "bridge", StageState.FAILED, 0.0, "no answer to step 60")
    folder = write_run(replace(run, statuses=[failed]), tmp_path / "bag")
    assert status(main, folder, "--quiet") == 1
    metrics = json.loads((folder / "metrics.json").read_text())
    said = capsys.readouterr()
    assert said.err == f"error: {folder}: the run is not valid: {metrics['why']}\n" and "step 60" in metrics["why"]
    assert said.out == ""


@pytest.mark.parametrize("name", [FILES[0], "file"])
def test_output_that_cannot_be_written_is_named(
    name: str, run: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(run, tmp_path / "bag")
    (folder / name).mkdir() if name in FILES else (folder / name).touch()
    assert f"error: {folder / name}: cannot be written: " in refusal(
        capsys, main, folder, *([] if name in FILES else ["--out", str(folder / name)])
    )
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


def test_bare_runs_can_be_drawn_and_printed(tmp_path: Path) -> None:
    """One agent, which is not the ego; no log, no net, nobody under control."""
    run = make_run([table(k, {"id": 5, "x": 1.0 * k, "y": 0.0}) for k in range(3)], log=[], statuses=[])
    metrics = measure(read_run(write_run(run, tmp_path / "bag")), tmp_path / "bag")
    assert metrics["collision"]["rate_controlled"] is None
    assert metrics["timing"]["wall_s"] is None
    print_metrics(metrics)


def test_metrics_without_numbers_are_refused(tmp_path: Path) -> None:
    metrics = {"x": {"y": [1.0, {"5": float("nan")}]}, "z": float("inf"), "n": 1.0, "why": "no positions at 3 steps"}
    expected = r"m\.json: x\.y\.1\.5 and 1 more not finite, expected finite numbers: no positions at 3 steps"
    with pytest.raises(InputError, match=expected):
        write_metrics(metrics, tmp_path / "m.json")
    with pytest.raises(InputError, match=r"m\.json: z not finite, expected finite numbers$"):
        write_metrics({"z": float("nan")}, tmp_path / "m.json")


def test_rates_with_and_without_the_contacts_of_the_log() -> None:
    """The log has 4 in 5; the run adds the ego into 2, and 2 into 3. Agent 6 never enters."""

    def step(k: int, ego: float, third: float, *more: dict[str, Any]) -> Any:
        others = {2: (10.0, 0.0), 3: (third, 0.0), 4: (60.0, 9.0), 5: (61.0, 9.0)}
        rows = ({"id": a, "x": x, "y": y} for a, (x, y) in others.items())
        return table(k, {"id": 1, "x": ego, "y": 0.0, "controller": Controller.EGO}, *rows, *more)

    log = [step(k, -20.0, 40.0, {"id": 6, "x": 90.0, "y": 9.0}) for k in range(60)]
    run = [step(k, 6.5 if k > 30 else -20.0, 13.5 if k > 40 else 40.0) for k in range(60)]
    metrics = compute_metrics(make_run(run, log))
    hits = metrics["collision"]
    assert sum(hits["by_fault"].values()) == hits["excess"] == 2
    assert (hits["agents"], hits["excess_agents"]) == (5, 3)
    assert hits["rate_all"] == pytest.approx(5 / 6)  # who never enters is one of them
    assert hits["excess_rate_all"] == pytest.approx(3 / 6)
    assert not metrics["reactive"] and not metrics["collision_free"]
    same = compute_metrics(make_run(log))
    assert same["reactive"] and not same["collision_free"]
    assert same["collision"]["excess_rate_all"] == 0.0 < same["collision"]["rate_all"]


@pytest.mark.parametrize(("distance", "share"), [(29.9, 0.5), (30.1, 0.0)])
def test_takeovers_count_as_near_within_the_region_around_the_ego(distance: float, share: float) -> None:
    tables = [
        table(k, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": distance, "y": 0.0}, {"id": 3, "x": 90.0, "y": 0.0})
        for k in range(20)
    ]
    run = make_run(tables, takeovers={k: [takeover(2, detected_step=5)] for k in range(5, 9)})
    metrics = compute_metrics(run)
    assert metrics["relevant_ratio"] == 0.5
    assert metrics["relevant_ratio_roi"] == share
    assert metrics["ledger"][0]["ego_distance_m"] == pytest.approx(distance)
