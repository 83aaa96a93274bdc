"""Changes of a scenario: what they do to the log, and what is wrong with one is named."""

from typing import Any

import numpy as np
import pytest
import yaml

from litsim_sim.core.errors import InputError
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario, packaged

HISTORY = 30
EGO, LEADER, LATE = 1, 2, 3
DEMO_IDENTITY = "demo-idm-replay-6-0-d62d44f1"  # as of runs before there were changes


@pytest.fixture(scope="module")
def tracks(track) -> list[Any]:
    return [
        track(EGO, x=100.0, last=120),
        track(LEADER, x=140.0, last=120),
        track(LATE, x=60.0, first=50, last=120),
    ]


def test_start_moves_the_ego_alone_and_smoothly(make_scenario, tracks) -> None:
    plain = make_scenario(*tracks, history_steps=HISTORY)
    start = {"kind": "start", "agent": EGO, "faster": 2.0, "left": 0.5}
    log, before = make_scenario(*tracks, history_steps=HISTORY, changes=[start]).log, plain.log
    ego, others = log.row(EGO), log.ids != EGO
    assert log.x[ego, 0] == before.x[ego, 0] and log.speed[ego, 0] == before.speed[ego, 0]
    assert log.speed[ego, HISTORY] == pytest.approx(12.0)
    assert log.y[ego, HISTORY] == pytest.approx(before.y[ego, HISTORY] + 0.5)
    np.testing.assert_allclose(np.diff(log.x[ego, : HISTORY + 1]) / 0.1, log.speed[ego, :HISTORY], atol=0.15)
    np.testing.assert_array_equal(log.x[others], before.x[others])


def test_enter_shifts_a_track(make_scenario, tracks) -> None:
    earlier = make_scenario(*tracks, history_steps=HISTORY, changes=[{"kind": "enter", "agent": LATE, "later_s": -1.2}])
    row = earlier.log.row(LATE)
    assert earlier.log.first_step[row] == 38
    assert earlier.log.x[row, 38] == 60.0 and earlier.start_frame == 0 and earlier.total_steps == 120


def test_a_record_has_what_makes_the_same_log(make_scenario, tracks, tmp_path) -> None:
    changes = [
        {"kind": "enter", "agent": LATE, "later_s": -1.2},
        {"kind": "start", "agent": EGO, "faster": 1.0, "left": 0.3},
    ]
    fields = {"history_steps": HISTORY, "changes": changes, "simulation_s": 6.0}
    scenario = make_scenario(*tracks, **fields)
    scenario.recording.write(tmp_path / "again.parquet")  # as the recorder attaches it
    again = Scenario.from_yaml(
        yaml.safe_dump(yaml.safe_load(scenario.to_yaml()) | {"recording": str(tmp_path / "again.parquet")}), "again"
    )
    for name in ("ids", "valid", "x", "y", "yaw", "speed", "first_step", "last_step"):
        np.testing.assert_array_equal(getattr(again.log, name), getattr(scenario.log, name))
    assert again.total_steps == scenario.total_steps and scenario.log.last_step[scenario.log.row(LATE)] == 90


def test_signals_change_later() -> None:
    path = packaged("suites/small/street_14.yaml", "litsim_eval")
    before = Scenario.load(path).signals
    after = Scenario.load(path, changes=[{"kind": "signals", "later_s": 1.0}]).signals
    assert before is not None and after is not None
    np.testing.assert_array_equal(after.states[:, 10:], before.states[:, :-10])
    assert (after.states != before.states).any()


def test_vehicles_need_not_heed_signals_that_are_changed() -> None:
    path = packaged("suites/small/street_37.yaml", "litsim_eval")
    assert Scenario.load(path, changes=[{"kind": "signals", "later_s": 8.0}]).signals is not None


def test_a_change_is_in_the_identity_and_in_the_text(make_scenario, tracks) -> None:
    plain = make_scenario(*tracks, history_steps=HISTORY)
    brake = {"kind": "brake", "agent": LEADER, "begin_s": 4.0, "duration_s": 1.0, "deceleration": 2.0}
    changed = make_scenario(*tracks, history_steps=HISTORY, changes=[brake])
    assert RunPlan(changed, "idm", "replay").identity != RunPlan(plain, "idm", "replay").identity
    assert Scenario.from_yaml(changed.to_yaml(), "text").actors == changed.actors


def test_a_change_without_headway_has_the_fields_of_before_and_one_with_it_stays_as_it_is(
    make_scenario, tracks
) -> None:
    brake = {"kind": "brake", "agent": LEADER, "begin_s": 4.0, "duration_s": 1.0, "deceleration": 2.0}
    waits = {"kind": "cut_in", "agent": LEADER, "begin_s": 4.0, "duration_s": 2.0, "headway_s": [0.5, 1.0]}
    scenario = make_scenario(*tracks, history_steps=HISTORY, changes=[brake, waits])
    assert scenario.file.changes[0].model_dump(mode="json") == brake
    assert "from 4.0 s on, once 0.50 to 1.00 s ahead of the ego" in scenario.file.changes[1].text
    assert Scenario.from_yaml(scenario.to_yaml(), "text").file.changes == scenario.file.changes


def test_identities_of_before_changes_stay() -> None:
    assert RunPlan(Scenario.load("demo"), "idm", "replay").identity == DEMO_IDENTITY


def test_delay_is_of_the_ego_alone(make_scenario, tracks) -> None:
    delay = {"kind": "delay", "later_s": 0.4}
    scenario = make_scenario(*tracks, history_steps=HISTORY, changes=[delay], vehicle={"delay_s": 0.1})
    assert scenario.vehicle.delay_s == 0.5 and scenario.vehicle.delay_steps == 5
    assert make_scenario(*tracks, history_steps=HISTORY).vehicle.delay_s == 0.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": "brake", "agent": 9, "begin_s": 4.0}, "changes.0.agent: no agent 9 in these steps"),
        ({"kind": "brake", "agent": EGO, "begin_s": 4.0}, "changes.0.agent: 1, expected another agent than the ego"),
        ({"kind": "start", "agent": LEADER, "left": 0.2}, "changes.0.agent: 2, expected the ego"),
        (
            {"kind": "enter", "agent": LEADER, "later_s": 1.0},
            "2 is there in the history, expected one that enters later",
        ),
        ({"kind": "brake", "agent": LEADER, "begin_s": 1.0}, "begin_s: 1 s, expected at least the history of 3 s"),
        (
            {"kind": "cross", "agent": LEADER, "begin_s": 4.0, "speed": 1.4},
            "2 is a car, expected a pedestrian or cyclist",
        ),
        ({"kind": "brake", "agent": LEADER, "begin_s": 4.0, "headway_s": [2.0, 1.0]}, "headway_s"),
        ({"kind": "hide", "agent": EGO, "begin_s": 4.0, "duration_s": 1.0}, "expected another agent than the ego"),
        ({"kind": "inattentive", "agent": LEADER, "later_s": 0.25}, "multiple of 0.1"),
        ({"kind": "noise", "sigma_m": -1.0}, "sigma_m"),
        ({"kind": "swerve", "agent": LEADER}, "swerve"),
        ({"kind": "pace", "agent": LEADER, "begin_s": 4.0, "duration_s": 1.0, "factor": -1.0}, "factor"),
    ],
)
def test_what_is_wrong_with_a_change_is_named(make_scenario, tracks, change: dict[str, Any], said: str) -> None:
    if change["kind"] == "brake":
        change = change | {"duration_s": 1.0, "deceleration": 2.0}
    with pytest.raises(InputError, match="changes") as refused:
        make_scenario(*tracks, history_steps=HISTORY, changes=[change])
    assert said in str(refused.value)
