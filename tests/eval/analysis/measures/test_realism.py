"""Likelihood under the log's histograms."""

from typing import Any

import pytest

from litsim_eval.analysis.measures.motion_features import FEATURES
from litsim_eval.analysis.measures.realism import Naturalness, Realism
from litsim_eval.analysis.measures.signals import Passage
from litsim_sim.core.scene import Controller
from litsim_sim.core.signals import SignalState
from made_runs import table


def realism(tables: Any, log: Any, agents: set[int], *given: Any) -> Realism | None:
    return Naturalness(tables, log, agents, *given).of(agents)


def traffic(speed: float = 10.0, second: float = 20.0) -> list[Any]:
    """Three vehicles in a column, those behind at distances of `second`."""
    return [
        table(k, *({"id": a, "x": 0.1 * speed * k - second * a, "y": 0.0, "speed": speed} for a in (1, 2, 3)))
        for k in range(40)
    ]


def test_the_log_itself_is_as_likely_as_the_log() -> None:
    log = traffic()
    found = realism(log, log, {1, 2, 3}, None, 0.1)
    assert found is not None
    assert found.score == pytest.approx(1.0)
    assert set(found.features) == set(FEATURES) - {"distance_to_road_edge", "off_road", "traffic_light_violation"}


def test_what_the_log_never_does_is_unlikely() -> None:
    log = traffic()
    fast = realism(traffic(speed=30.0), log, {2}, None, 0.1)
    touching = realism(traffic(second=3.0), log, {2}, None, 0.1)
    assert fast is not None
    assert touching is not None
    assert fast.features["linear_speed"] < 0.1
    assert fast.features["collision"] == pytest.approx(1.0)
    assert touching.features["collision"] < 0.1
    assert touching.score < fast.score < 1.0


def test_nobody_under_control_is_nothing_to_judge() -> None:
    log = traffic()
    assert realism(log, log, set(), None, 0.1) is None


def passages(*states: SignalState, agent: int = 2) -> list[Passage]:
    """Stop lines that `agent` passes while these states are shown."""
    return [Passage(agent, 10 + k, "a -> b", "1", state, Controller.POLICY) for k, state in enumerate(states)]


def test_red_lights_run_are_as_unlikely_as_in_the_log() -> None:
    log, green, red = traffic(), SignalState.GREEN, SignalState.RED
    heeded = passages(*[green] * 20)
    lawful = realism(log, log, {2}, None, 0.1, passages(green, green), heeded)
    unlawful = realism(log, log, {2}, None, 0.1, passages(green, red), heeded)
    assert lawful is not None and unlawful is not None
    assert lawful.features["traffic_light_violation"] == pytest.approx(1.0, abs=0.01)
    assert unlawful.features["traffic_light_violation"] < 0.1
    assert unlawful.score < lawful.score


def test_where_nobody_who_is_judged_passes_a_stop_line_there_is_no_such_term() -> None:
    log, heeded = traffic(), passages(SignalState.GREEN)
    for passed in ([], passages(SignalState.RED, agent=3)):
        found = realism(log, log, {2}, None, 0.1, passed, heeded)
        assert found is not None
        assert "traffic_light_violation" not in found.features


def test_some_of_those_that_were_looked_at_are_judged_as_if_they_were_all() -> None:
    log, run = traffic(), traffic(speed=12.0, second=8.0)
    everybody = Naturalness(run, log, {1, 2, 3}, None, 0.1)
    assert everybody.of({2}) == realism(run, log, {2}, None, 0.1)
    assert everybody.of({2}) != everybody.of({1, 2, 3})


def test_motion_over_steps_that_are_lost_is_not_that_of_one_step() -> None:
    """Speeding up by 1 m/s2 from step 10 on; steps before one that is looked at are lost."""
    log = [
        table(k, *({"id": a, "x": 1.0 * k - 20.0 * a, "y": 0.0, "speed": 10.0 + 0.1 * max(0, k - 9)} for a in (1, 2)))
        for k in range(40)
    ]
    kept = [each for each in log if not 15 <= each.step < 19]
    found = realism(kept, log, {2}, None, 0.1)
    assert found is not None
    assert found.features["linear_acceleration"] > 0.9, "5 m/s2, as it would be over one step, never happens in the log"
