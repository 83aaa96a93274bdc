"""Whole runs in process, of the packaged demo and of real traffic."""

import itertools
import subprocess
import sys
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from campaigns import EGOS
from litsim_eval.analysis.measures.collision import Pair, contacts
from litsim_eval.analysis.measures.identity import digest
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.in_process import record
from litsim_sim.core.scene import AgentTable, Controller, ControlSource
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.record.run import Run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation
from litsim_sim.world.sumo import SumoMirror

EVERYBODY = (Controller.LOG, Controller.POLICY, Controller.EGO)
DRIVEN = (Controller.POLICY, Controller.EGO)


LOADED_LATE = """
from litsim_sim.simulation import Simulation
from litsim_sim.kernels import compiled
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

simulation = Simulation.of(RunPlan(Scenario.load("demo"), "idm", "litsim"))
before = {each for each in compiled.KERNELS if "loaded" in vars(each)}
for _ in zip(range(80), simulation.steps()):
    pass
print(len(before) > 20, *(each.__name__ for each in compiled.KERNELS if "loaded" in vars(each) and each not in before))
"""


@pytest.fixture(scope="module")
def demo() -> Scenario:
    return Scenario.load("demo")


@pytest.fixture(scope="module")
def litsim(demo: Scenario, drive):
    return drive(demo, "idm", policy="litsim")


@pytest.fixture(scope="module")
def recorded() -> Run:
    return record(RunPlan(Scenario.load("demo"), "idm", "litsim"))


@pytest.fixture(scope="module")
def replayed(demo: Scenario) -> Run:
    return record(RunPlan(demo, "idm", "replay"))


def run_of(scenario: Scenario, ego: str, policy: str) -> Run:
    return record(RunPlan(scenario, ego, policy))


def pairs(tables: Iterable[AgentTable]) -> set[Pair]:
    """Ids of each two that touch at some time."""
    return {contact.pair for contact in contacts(tables, 0.1)}


def errors(run: Run) -> np.ndarray:
    """Distance from the log of every agent at every step [m]."""
    found = [np.empty(0)]
    for table, logged in zip(run.tables, run.log, strict=True):
        assert table.id.tolist() == logged.id.tolist()
        found.append(np.hypot(table.x - logged.x, table.y - logged.y))
    return np.concatenate(found)


# The shell


def test_every_step_is_answered_once(demo: Scenario, litsim) -> None:
    steps = list(range(demo.total_steps + 1))
    assert [r.table.step for r in litsim.results] == steps
    for part in ("takeovers", "controls", "ego"):
        assert [getattr(r, part).step for r in litsim.results] == steps
    assert all({"bridge", "predictor", "conflict", "policy", "ego"} == set(r.stage_s) for r in litsim.results)


def test_pure_replay_has_neither_takeovers_nor_controls(replayed: Run) -> None:
    assert not replayed.takeovers and not replayed.controls
    assert not any((table.controller == Controller.POLICY).any() for table in replayed.tables)


def test_exactly_those_with_an_answer_are_under_control_at_the_next_step(litsim) -> None:
    for now, then in zip(litsim.results, litsim.results[1:], strict=False):
        driven = set(then.table.id[then.table.controller == Controller.POLICY].tolist())
        gone = set(now.table.id.tolist()) - set(then.table.id.tolist())
        answered = now.controls.id[now.controls.source != ControlSource.LATE]  # those follow a log that lags
        assert driven - litsim.world.entries.late == set(answered.tolist()) - gone - litsim.world.entries.late


def test_a_run_with_the_ego_on_its_log_is_the_recording_and_can_be_shown_while_it_goes(demo: Scenario) -> None:
    ticks = []
    run = record(RunPlan(demo, "log", "replay"), progress=lambda: ticks.append(1))
    assert len(ticks) == demo.total_steps + 1
    assert run.complete and run.info.run_id == RunPlan(demo, "log", "replay").run_id
    assert len(errors(run)) > 10_000 and errors(run).max() < 1e-6


def test_stages_are_timed_by_the_clock_that_is_given(demo: Scenario) -> None:
    ticks = itertools.count()
    simulation = Simulation.of(RunPlan(demo, "idm", "litsim"), clock=lambda: 10.0 * next(ticks))
    (now,) = itertools.islice(simulation.steps(), 1)
    assert now.stage_s == dict.fromkeys(("bridge", "predictor", "conflict", "policy", "ego"), 10.0)


# The demo


def test_litsim_mends_what_replay_runs_into(replayed: Run, recorded: Run) -> None:
    replay, mended = compute_metrics(replayed), compute_metrics(recorded)
    assert mended["collision"]["excess"] == 0 and mended["reactive"]
    assert replay["collision"]["excess"] > 3 and not replay["reactive"]
    assert mended["collision"]["pairs"] < replay["collision"]["pairs"]
    assert pairs(recorded.simulated) <= pairs(recorded.simulated_log)
    assert 0.0 < mended["relevant_ratio"] < 0.2, "most of the traffic is left alone"
    assert mended["replay_error_max_m"] < 1e-6, "and exactly where it was"


def test_forecasts_that_nobody_reads_change_nothing() -> None:
    """Who is taken over, when and why, and where everybody goes: with all forecasts as with those that are read."""
    runs, scenario = [], Scenario.load("demo", simulation_s=12.0)
    for everybody in (False, True):
        parameters = {"predictor": {"forecast_all": everybody}}
        runs.append(record(RunPlan(scenario, "perturbed", "litsim", parameters=parameters)))
    read, everything = runs
    assert any(read.takeovers.values())
    assert digest(read) == digest(everything)
    for step, takeovers in read.takeovers.items():
        told = [[(t.agent, t.opponent, t.state, t.detected_step) for t in run.takeovers[step]] for run in runs]
        assert told[0] == told[1], step
        assert len(takeovers) == len(everything.takeovers[step])


def test_sumo_only_shows(demo: Scenario, recorded: Run) -> None:
    mirrored = record(RunPlan(demo, "idm", "litsim"), SumoMirror(demo.net_path, demo.seed))
    assert digest(mirrored) == digest(recorded)
    assert mirrored.summary["sumo_deviation_m"] < 0.01 and recorded.summary["sumo_deviation_m"] is None


def test_nobody_moves_as_no_vehicle_can(litsim, beyond_limits) -> None:
    assert beyond_limits(litsim.results, DRIVEN) == []


@settings(max_examples=2, phases=(Phase.explicit, Phase.reuse, Phase.generate))  # a run is too long to be shrunk
@example(ego=4, handback="time_shift", kind="brake", deceleration=3.5, duration=4.0)
@given(
    st.sampled_from(EGOS),
    st.sampled_from(("catch_up", "time_shift")),
    st.sampled_from(["brake", "lane_change"]),
    st.floats(1.0, 6.0),
    st.floats(1.0, 4.0),
)
def test_over_whole_runs_nobody_jumps(drive, beyond_limits, ego, handback, kind, deceleration, duration) -> None:
    """Between two steps nobody moves farther than its speed lets it, nor beyond its limits, whoever drives it then."""
    perturbed = {"kind": kind, "deceleration": deceleration, "duration": duration}
    parameters = {"ego": perturbed, "conflict": {"handback": handback}}
    run = drive(Scenario.load("demo", ego=ego), "perturbed", parameters=parameters)
    assert beyond_limits(run.results, EVERYBODY) == []


def test_the_ledger_says_why_and_what_pure_replay_would_have_done(make_scenario, track) -> None:
    """A golden scene: the ego brakes from 10 to 2 m/s, 7.5 m before the follower that its log keeps at 10 m/s."""
    scenario = make_scenario(track(1, x=112.0, last=200), track(2, x=100.0, last=200))
    parameters = {"ego": {"kind": "brake", "time": (0.0, 0.0), "duration": 4.0}}
    replay = Simulation.of(RunPlan(scenario, "perturbed", "replay", parameters))
    assert len(list(replay.steps())) == 201
    by_contacts = parameters | {"conflict": {"unlikely": 0.0}}
    (entry,) = compute_metrics(record(RunPlan(scenario, "perturbed", "yield", by_contacts)))["ledger"]
    assert (entry["agent"], entry["opponent"], entry["reason"]) == (2, 1, "conflict")
    assert (entry["replay_opponent"], entry["replay_step"]) == (1, replay.world.contacts[(1, 2)])
    predicted = entry["detected_step"] + 10 * entry["time_to_conflict_s"]
    assert abs(predicted - entry["replay_step"]) <= 8, "the forecast of a braking ego, at first sight"
    assert entry["overlap_probability"] >= 0.4 and entry["log_collision_predicted"] and not entry["false_alarm"]
    steps = entry["released_step"] - entry["detected_step"] + 1
    assert entry["held_s"] == pytest.approx(0.1 * steps)
    assert 0.0 < entry["residual_m"] <= 0.5, "from the log that it goes back to"
    assert entry["time_shift_s"] > 0.5 and abs(entry["residual_mps"]) <= 1.5


def test_agents_off_their_logs_stay_on_the_road(demo: Scenario, litsim) -> None:
    for now in litsim.results:
        held = now.table.take(np.isin(now.table.controller, DRIVEN))
        assert demo.lane_map.inside_road(held.x, held.y).all()


def test_agents_do_not_flicker_between_holding_and_handing_back(litsim, demo: Scenario) -> None:
    times = {agent: litsim.life(agent).count(TakeoverState.HANDBACK) for agent in demo.log.ids.tolist()}
    begun = [count for count in times.values() if count]
    assert begun and max(begun) <= 3 and np.mean(begun) <= 2.0, times


# Real traffic


@pytest.fixture(scope="module")
def real(real_data) -> Scenario:
    real_data()
    return Scenario.load("us101_0750")


@pytest.mark.data
def test_real_traffic_reacts(real: Scenario, drive, beyond_limits) -> None:
    scenario = Scenario.load("us101_0750", ego=real.egos[3])
    replay = compute_metrics(run_of(scenario, "idm", "replay"))
    run = drive(scenario, "idm")
    log = pairs(scenario.log.table(step) for step in range(scenario.total_steps + 1))
    excess = pairs(r.table for r in run.results) - log
    assert not {pair for pair in excess if scenario.ego_id not in pair}, "background does not touch background"
    assert len(excess) <= 1 and len(excess) <= replay["collision"]["excess"]
    assert beyond_limits(run.results, DRIVEN) == []


@pytest.mark.data
def test_real_traffic_is_left_alone_when_the_ego_is_on_its_log(real: Scenario) -> None:
    metrics = compute_metrics(run_of(real, "log", "litsim"))
    assert metrics["relevant_ratio"] <= 0.05 and metrics["collision"]["excess"] == 0
    assert errors(run_of(real, "log", "replay")).max() < 1e-6


@pytest.mark.parametrize("policy", ["replay", "yield"])
def test_a_run_ends_when_the_ego_has_left_the_net(make_scenario, track, policy: str) -> None:
    """The end of the net is at 640 m; the log of the ego, which is slower, has it there until the end."""
    scenario = make_scenario(track(1, x=600.0, speed=3.0, last=100), track(2, x=300.0, last=100))
    run = record(RunPlan(scenario, "idm", policy))
    metrics = compute_metrics(run)
    last = run.tables[-1].step
    assert last < scenario.total_steps
    time_s = pytest.approx(0.1 * last)
    assert metrics["ended"] == {"reason": "net_end", "step": last, "time_s": time_s, "lane": "downstream_3"}
    assert metrics["valid"] and metrics["steps"] == last
    assert metrics["ego_motion"]["off_road"] == 0.0
    assert run.tables[-1].row(1) < 0 <= run.tables[-2].row(1)


def test_a_run_that_the_ego_does_not_leave_lasts_for_its_time(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0, last=40))
    metrics = compute_metrics(record(RunPlan(scenario, "idm", "replay")))
    assert metrics["ended"] == {"reason": "time", "step": 40, "time_s": 4.0, "lane": ""}


def test_all_kernels_are_loaded_before_the_first_step() -> None:
    ended = subprocess.run([sys.executable, "-c", LOADED_LATE], capture_output=True, text=True, check=True)
    assert ended.stdout.split() == ["True"]
