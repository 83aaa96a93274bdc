"""Runs that are stepped together: each is, to the last bit, what it is alone."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.batched import record_batch
from litsim_eval.runs.in_process import record
from litsim_sim.core.scene import ARRAY_FIELDS, AgentTable
from litsim_sim.record.run import Run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

Scenes = list[tuple[Scenario, str]]
LARGE = 2**40  # ids that are no row numbers


@pytest.fixture(scope="module")
def scenes(make_scenario: Callable[..., Any], track: type, lane_centres: tuple[float, ...]) -> Scenes:
    """Two egos of one recording and two of another, shorter one at the same place, in which a vehicle enters late."""
    demo = Scenario.load("demo", simulation_s=7.0)
    column = [
        track(LARGE + 7 * k, x=x, y=lane_centres[k % 3], speed=speed, last=80)
        for k, (x, speed) in enumerate([(120.0, 10.0), (140.0, 9.0), (96.0, 12.0), (80.0, 14.0), (102.0, 13.0)])
    ]
    entering = track(3, x=175.0, y=lane_centres[0], speed=4.0, first=45, last=80)
    other = make_scenario(*column, entering, history_steps=demo.history_steps, roi_m=demo.roi_m)
    return [
        (demo, "idm"),
        (other, "perturbed"),
        (demo.around(demo.egos[1], 3), "perturbed"),
        (other.around(LARGE + 7 * 4, 2), "idm"),
        (demo.around(demo.egos[2], None), "log"),
    ]


def same(a: Any, b: Any) -> bool:
    """Whether two tables, commands or takeovers are equal to the last bit."""
    return all(
        np.array_equal(getattr(a, f.name), getattr(b, f.name)) and type(a) is type(b) for f in dataclasses.fields(a)
    )


def assert_same(together: Run, alone: Run) -> None:
    assert len(together.tables) == len(alone.tables)
    for mine, other in zip(together.tables, alone.tables, strict=True):
        assert same(mine, other), mine.step
        assert [getattr(mine, f).dtype for f in ARRAY_FIELDS] == [getattr(other, f).dtype for f in ARRAY_FIELDS]
    for part in ("controls", "ego_commands", "detections"):
        mine, other = getattr(together, part), getattr(alone, part)
        assert list(mine) == list(other)
        assert all(same(mine[step], other[step]) for step in mine), part
    assert list(together.takeovers) == list(alone.takeovers)
    for step, listed in together.takeovers.items():
        assert len(listed) == len(alone.takeovers[step])
        assert all(same(a, b) for a, b in zip(listed, alone.takeovers[step], strict=True)), step
    measured, expected = (compute_metrics(run) for run in (together, alone))
    assert measured["digest"] == expected["digest"]
    del measured["timing"], expected["timing"]
    assert measured == expected
    assert together.statuses[-1].text == alone.statuses[-1].text


@pytest.mark.parametrize(
    ("policy", "parameters"),
    [
        ("replay", {}),
        ("yield", {"predictor": {"model": "kinematic"}}),
        ("litsim", {}),
        ("idm", {"policy": {"baseline.drivers": "drawn"}}),
        ("simnet", {}),
        ("rollout", {}),
        ("rail", {"policy": {"imitation.actions": "drawn"}}),
    ],
)
def test_every_run_is_what_it_is_alone(scenes: Scenes, policy: str, parameters: dict[str, dict[str, str]]) -> None:
    some = scenes[:2] if policy in ("simnet", "rail") else scenes  # their networks take long
    plans = [RunPlan(scenario, ego, policy, parameters) for scenario, ego in some]
    together = record_batch(plans)
    for run, plan in zip(together, plans, strict=True):
        assert run.complete and run.info.run_id == plan.run_id
        assert_same(run, record(plan))
    if policy != "replay":
        driven = [any(run.takeovers.values()) for run in together]
        assert driven[0] and driven[1], "the scenes must have something to react to"
    assert len({len(run.tables) for run in together}) > 1, "some must be over sooner than others"


def test_scenes_whose_signals_differ_are_each_what_they_are_alone(make_scenario: Any, track: type) -> None:
    """The ego, and who is taken over behind it, come to a light that is red for longer in one scene than in others."""

    def scene(red_until: float) -> Scenario:
        changes = [[0.0, "east", "red"], [red_until, "east", "green"]]
        column = [track(k, x=-150.0 - 12.0 * k, y=-4.95, speed=10.0, last=90) for k in range(1, 4)]
        signals = {"groups": {"east": ["WA_0", "WA_1"]}, "changes": changes}
        return make_scenario(*column, net="urban_like", signals=signals)

    scenes = [scene(7.0), scene(2.0), scene(7.0).around(2, 5)]
    plans = [RunPlan(each, "idm", "litsim") for each in scenes]
    runs = record_batch(plans)
    for run, plan in zip(runs, plans, strict=True):
        assert_same(run, record(plan))
        assert any(run.takeovers.values())
    stands = [min(float(table.speed.min()) for table in run.tables) for run in runs]
    assert stands[0] < 2.0 < stands[1], "one of them waits at the light"


def test_a_run_that_a_contact_ends_ends_no_other(make_scenario: Callable[..., Any], track: type) -> None:
    """The egos brake, and the log has the one behind each drive on."""
    column = [track(1, x=100.0, speed=8.0, last=60), track(2, x=92.0, speed=8.0, last=60)]
    ending, going_on = (make_scenario(*column, end_after_contact_s=after) for after in (0.2, None))
    brakes = {"ego": {"kind": "brake", "time": (0.0, 0.0)}}
    plans = [RunPlan(each, "perturbed", "replay", brakes) for each in (ending, going_on, ending)]
    together = record_batch(plans)
    for run, plan in zip(together, plans, strict=True):
        assert_same(run, record(plan))
    reasons = [run.ended.reason for run in together if run.ended is not None]
    assert reasons == ["contact", "time", "contact"]


def test_runs_that_differ_in_what_stages_ask_are_not_joined(scenes: Scenes) -> None:
    demo, wider = scenes[0][0], Scenario.load("demo", simulation_s=9.0, roi_m=60.0)
    with pytest.raises(ValueError, match="policies or parameters"):
        record_batch([RunPlan(demo, "idm", "yield"), RunPlan(demo, "idm", "litsim")])
    with pytest.raises(ValueError, match="cannot be batched"):
        record_batch([RunPlan(demo, "idm", "yield"), RunPlan(wider, "idm", "yield")])


def test_runs_of_one_scenario_have_their_log_in_common_and_are_measured_as_alone(scenes: Scenes) -> None:
    plans = [RunPlan(scenes[k][0], scenes[k][1], "yield") for k in (0, 2, 4)]
    runs = record_batch(plans)
    for one, other in ((one, other) for one in runs for other in runs):
        assert (one.logged is other.logged) == (one.tables[-1].step == other.tables[-1].step)
    assert runs[0].logged is runs[2].logged, "neither leaves the road before the log is over"
    for run in runs:
        log = [AgentTable(t.step, *(getattr(t, f).copy() for f in ARRAY_FIELDS)) for t in run.log]
        alone = compute_metrics(dataclasses.replace(run, log=log))
        assert compute_metrics(run) == alone
