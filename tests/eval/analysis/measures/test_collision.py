"""Contacts and whose fault they are: one small scene per verdict, and its twin just beside it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import litsim_sim
from litsim_eval.analysis.measures.collision import Impact, collisions, contacts, judge
from litsim_sim.core.scene import Controller
from litsim_sim.lane_map.lane_map import LaneMap
from made_runs import make_run, table

NET = Path(litsim_sim.__file__).parent / "nets/us101_like.net.xml"  # lanes of 3.66 m, the leftmost at y = -1.83


def verdict(ego: dict[str, float], agent: dict[str, float], inside: bool = True) -> tuple[Impact, bool]:
    scene = table(5, {"id": 1, "x": 0.0, "y": 0.0} | ego, {"id": 2, "y": 0.0, "speed": 15.0} | agent)
    assert [contact.pair for contact in contacts([scene], 0.1)] == [(1, 2)], "the scene must be a contact"
    contact = judge(scene, 1, 2, cast(LaneMap, SimpleNamespace(inside_lane=lambda *_: [inside])))
    assert (contact.step, contact.agent) == (5, 2)
    return contact.verdict, contact.ego_at_fault


@pytest.mark.parametrize(
    ("ego", "agent", "inside", "expected"),
    [
        ({"speed": 0.05}, {"x": 3.8}, True, (Impact.STOPPED_EGO, False)),
        ({"speed": 0.06}, {"x": 3.8}, True, (Impact.FRONT, True)),  # an ego that creeps is judged
        ({}, {"x": 3.8, "speed": 0.05}, True, (Impact.STOPPED_TRACK, True)),  # wherever it is
        ({}, {"x": -3.8, "speed": 0.0}, True, (Impact.STOPPED_TRACK, True)),
        ({}, {"x": -3.8, "speed": 0.06}, True, (Impact.REAR, False)),
        ({}, {"x": -3.8, "y": 0.5}, True, (Impact.REAR, False)),
        ({}, {"x": -3.0, "y": 1.8}, False, (Impact.LATERAL, True)),  # at the rear corner, not behind
        ({}, {"x": 3.8}, True, (Impact.FRONT, True)),
        ({}, {"x": 1.0, "y": 1.9}, True, (Impact.FRONT, True)),  # it cuts in: its rear is at the bumper
        ({}, {"x": -0.1, "y": 1.9}, True, (Impact.LATERAL, False)),  # beside the bumper
        ({}, {"x": -0.1, "y": 1.9}, False, (Impact.LATERAL, True)),  # the ego is out of its lane
    ],
)
def test_verdicts(ego: dict[str, float], agent: dict[str, float], inside: bool, expected: tuple[Impact, bool]) -> None:
    assert verdict(ego, agent, inside) == expected


@pytest.mark.parametrize("turn", [0.0, 0.7, np.pi, -2.0])
def test_verdicts_turn_with_the_scene(turn: float) -> None:
    cos, sin = np.cos(turn), np.sin(turn)
    for (x, y), expected in (((-3.8, 0.5), "rear"), ((3.8, 0.0), "front"), ((-0.1, 1.9), "lateral")):
        agent = {"x": x * cos - y * sin, "y": x * sin + y * cos, "yaw": turn}
        assert verdict({"yaw": turn}, agent)[0] == expected


@pytest.mark.parametrize(("y", "at_fault"), [(-1.83, False), (-2.60, False), (-2.80, True)])
def test_lane_of_the_attached_net_decides(y: float, at_fault: bool) -> None:
    scene = table(1, {"id": 1, "x": 100.0, "y": y}, {"id": 2, "x": 99.9, "y": y - 1.9, "speed": 15.0})
    run = make_run([table(0), scene], net_xml=NET.read_bytes())
    (contact,) = collisions(run).ego
    assert (contact.verdict, contact.ego_at_fault) == (Impact.LATERAL, at_fault)


def test_without_a_net_lateral_contacts_are_the_ego_s_fault() -> None:
    scene = table(1, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": -0.1, "y": 1.9})
    assert collisions(make_run([table(0), scene])).ego[0].ego_at_fault


def test_what_is_behind_the_ego_is_seen_from_the_rear_axle_of_its_own_vehicle() -> None:
    run = make_run([table(k, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": -3.8, "y": 1.2}) for k in range(3)])
    for vehicle, expected in (("{}", Impact.REAR), ("{rear_axle: 0.5}", Impact.LATERAL)):
        made = replace(run, scenario_yaml=f"start_frame: 0\nvehicle: {vehicle}\n")
        assert [contact.verdict for contact in collisions(made).ego] == [expected]


def test_delta_v_is_half_the_difference_of_the_velocities() -> None:
    scene = table(0, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 1.0, "y": 0.0, "speed": 15.0})
    assert judge(scene, 1, 2).delta_v == pytest.approx(2.5)
    scene = table(0, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 1.0, "y": 0.0, "yaw": np.pi / 2})
    assert judge(scene, 1, 2).delta_v == pytest.approx(0.5 * np.hypot(10, 10))


def test_a_pair_counts_once_however_long() -> None:
    apart = ({"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 4.0, "y": 0.0}, {"id": 3, "x": 50.0, "y": 0.0})
    close = (apart[0], apart[1] | {"x": 3.99, "controller": Controller.POLICY}, apart[2])
    run = make_run([table(0, *apart), *(table(k, *close) for k in (1, 2)), table(3, *apart), table(4, *close)], log=[])
    found = collisions(run)
    assert found.first == {(1, 2): 1}
    assert found.colliding == {1, 2}
    assert found.agents == {1, 2, 3}
    assert found.controlled == {2}


def test_log_s_own_contacts_are_the_floor() -> None:
    def scene(step: int, x3: float) -> Any:
        return table(step, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 3.0, "y": 0.0}, {"id": 3, "x": x3, "y": 0.0})

    run = make_run([scene(k, 6.0) for k in range(3)], log=[scene(k, 9.0) for k in range(3)])
    found = collisions(run)
    assert found.log == {(1, 2): 1}
    assert found.first == {(1, 2): 1, (2, 3): 1}
    assert found.excess == {(2, 3): 1}


def test_contacts_of_the_history_do_not_count() -> None:
    scene = [table(k, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 3.0 + k, "y": 0.0}) for k in range(4)]
    assert collisions(make_run(scene, history_steps=0)).first == {}
    assert collisions(make_run(scene, log=scene, history_steps=0)).log == {}
    assert collisions(make_run(scene, history_steps=-1)).first == {(1, 2): 0}
