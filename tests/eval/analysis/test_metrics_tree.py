"""The fields of metrics.json are known before a run, and all that a run has are among them."""

from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.metrics import compute_metrics, find_field, leaves, metric_fields
from litsim_sim.core.scene import Controller
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.mission import Mission
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals
from made_runs import make_run, table


@pytest.fixture
def metrics() -> dict[str, Any]:
    """A run with contacts, a takeover, a road and times: of every family of measures there is one."""
    log = [table(k, *({"id": a, "x": 20.0 * a + k, "y": -1.83} for a in (1, 2, 3))) for k in range(61)]
    tables = [
        table(
            k,
            {"id": 1, "x": 20.0 + 2 * k, "y": -1.83, "controller": Controller.EGO},
            {"id": 2, "x": 40.0 + k, "y": -1.83, "controller": Controller.POLICY},
            {"id": 3, "x": 60.0 + k, "y": -1.83},
        )
        for k in range(61)
    ]
    times = {"policy": dict.fromkeys(range(61), 0.002)}
    net_xml = packaged("nets/us101_like.net.xml").read_bytes()
    signals = Signals(("1",), (), np.empty(0, np.int64), np.zeros((1, 61), np.uint8))
    lanes = len(LaneMap.from_net(packaged("nets/us101_like.net.xml")).lanes)
    mission = Mission(np.zeros((2, 2)), np.zeros(3), np.ones(lanes, np.bool_), np.zeros(lanes))
    given = {"timing": times, "net_xml": net_xml, "signals": signals, "mission": mission}
    return compute_metrics(make_run(tables, log, **given))


def test_every_leaf_of_a_run_is_a_field_of_its_kind(metrics: dict[str, Any]) -> None:
    found = leaves(metrics)
    assert len(found) > 80 and found["realism.score"] is not None and found["fault.of_ego"] is not None
    for name, value in found.items():
        field = find_field(name)
        assert value is None or type(value) in field.kinds | ({int} if float in field.kinds else set()), name


def test_every_field_that_a_run_must_have_is_in_it(metrics: dict[str, Any]) -> None:
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
            assert field.name in leaves(metrics), field.name


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("collision.ego_fault", r"collision\.ego_at_fault"),
        ("safety.ttc_min_s", r"safety\.min_ttc_s"),
        ("safety.ttc_below", r"safety\.ttc_below\.0\.95, safety\.ttc_below\.1\.5"),
        ("hard_brakes", r"ego_motion\.hard_brakes, .*comfort\.ego\.hard_brakes"),
        ("comfort.ego.within.jerks", r"comfort\.ego\.within\.jerk"),
        ("ade_ego_m.7", r"ade_ego_m\.5"),
    ],
)
def test_an_unknown_field_names_those_called_nearly_so(name: str, near: str) -> None:
    with pytest.raises(ValueError, match=rf"no field {name} of metrics\.json \(near: .*{near}"):
        find_field(name)


def test_what_is_near_nothing_is_told_where_to_look() -> None:
    with pytest.raises(ValueError, match=r"no field qqq of metrics\.json; docs/metrics\.md has all"):
        find_field("qqq")


@pytest.mark.parametrize("name", ["timing.stage_ms.ego.max", "lockstep.missed_by_topic./litsim/ego/control"])
def test_keys_that_only_a_run_knows(name: str) -> None:
    assert find_field(name).counts


@pytest.mark.parametrize("name", ["timing.stage_ms..max", "timing.stage_ms.ego", "lockstep.missed_by_topic."])
def test_a_key_that_only_a_run_knows_is_not_empty(name: str) -> None:
    with pytest.raises(ValueError, match="no field"):
        find_field(name)


@pytest.mark.parametrize(("name", "counts"), [("takeovers", True), ("ledger", True), ("valid", False), ("why", False)])
def test_what_bounds_can_be_set_to(name: str, counts: bool) -> None:
    assert find_field(name).counts is counts
