"""What the ego is told of others: agents that are hidden for a time, and positions with errors."""

import numpy as np

from litsim_sim.scenario.batched import kind
from litsim_sim.scenario.perception import Perception

EGO, OTHER = 1, 2
HIDE = {"kind": "hide", "agent": OTHER, "begin_s": 1.0, "duration_s": 0.5}


def test_without_changes_it_is_the_truth(make_scenario, track) -> None:
    scenario = make_scenario(track(EGO, x=100.0), track(OTHER, x=140.0))
    table = scenario.log.table(5)
    assert Perception(scenario).of(table) is table


def test_an_agent_is_hidden_for_a_time(make_scenario, track) -> None:
    scenario = make_scenario(track(EGO, x=100.0), track(OTHER, x=140.0), changes=[HIDE])
    perception = Perception(scenario)
    hidden = [step for step in range(20) if perception.of(scenario.log.table(step)).row(OTHER) < 0]
    assert hidden == [10, 11, 12, 13, 14]


def test_positions_of_others_have_errors(make_scenario, track) -> None:
    tracks = (track(EGO, x=100.0, last=100), track(OTHER, x=140.0, last=100))
    scenario = make_scenario(*tracks, changes=[{"kind": "noise", "sigma_m": 0.5}])
    tables = [scenario.log.table(step) for step in range(scenario.total_steps)]
    perception, again = Perception(scenario), Perception(scenario)
    told = [perception.of(table) for table in tables]
    errors = np.array([[t.x[1] - table.x[1], t.y[1] - table.y[1]] for t, table in zip(told, tables, strict=True)])
    assert 0.3 < errors.std() < 0.7 and abs(errors.mean()) < 0.2
    assert all(t.x[0] == table.x[0] and t.speed[1] == table.speed[1] for t, table in zip(told, tables, strict=True))
    assert all((again.of(table).x == t.x).all() for t, table in zip(told, tables, strict=True))  # the same in each run


def test_scenarios_with_errors_are_not_stepped_together(make_scenario, track) -> None:
    tracks = (track(EGO, x=100.0), track(OTHER, x=140.0))
    one, other = (make_scenario(*tracks, changes=[HIDE]) for _ in range(2))
    assert kind(one) != kind(other)
