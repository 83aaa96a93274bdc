"""Contacts and whose fault they are: one small scene per verdict, and its twin just beside it."""

from collections.abc import Callable
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

NET = Path(litsim_sim.__file__).parent / "nets/us101_like.net.xml"  # lanes of 3.66 m, the leftmost at y = -1.83
Make = Callable[..., Any]


def verdict(table: Make, ego: dict[str, float], agent: dict[str, float], inside: bool = True) -> tuple[Impact, bool]:
    scene = table(5, {"id": 1, "x": 0.0, "y": 0.0} | ego, {"id": 2, "speed": 15.0} | agent)
    assert [contact.pair for contact in contacts([scene], 0.1)] == [(1, 2)], "the scene must be a contact"
    contact = judge(scene, 1, 2, cast(LaneMap, SimpleNamespace(inside_lane=lambda *_: [inside])))
    assert contact.step == 5
    assert contact.agent == 2
    return contact.verdict, contact.ego_at_fault


def test_stopped_ego_is_not_at_fault(table: Make) -> None:
    assert verdict(table, {"speed": 0.05}, {"x": 3.8, "y": 0.0}) == (Impact.STOPPED_EGO, False)


def test_ego_that_creeps_is_judged(table: Make) -> None:
    assert verdict(table, {"speed": 0.06}, {"x": 3.8, "y": 0.0}) == (Impact.FRONT, True)


def test_stopped_track_is_the_ego_s_fault_wherever_it_is(table: Make) -> None:
    assert verdict(table, {}, {"x": 3.8, "y": 0.0, "speed": 0.05}) == (Impact.STOPPED_TRACK, True)
    assert verdict(table, {}, {"x": -3.8, "y": 0.0, "speed": 0.0}) == (Impact.STOPPED_TRACK, True)


def test_track_that_creeps_is_judged(table: Make) -> None:
    assert verdict(table, {}, {"x": -3.8, "y": 0.0, "speed": 0.06}) == (Impact.REAR, False)


def test_track_behind_runs_into_the_ego(table: Make) -> None:
    assert verdict(table, {}, {"x": -3.8, "y": 0.5}) == (Impact.REAR, False)


def test_track_at_the_rear_corner_is_not_behind(table: Make) -> None:
    assert verdict(table, {}, {"x": -3.0, "y": 1.8}, inside=False) == (Impact.LATERAL, True)


def test_front_bumper_meets_the_track(table: Make) -> None:
    assert verdict(table, {}, {"x": 3.8, "y": 0.0}) == (Impact.FRONT, True)
    assert verdict(table, {}, {"x": 1.0, "y": 1.9}) == (Impact.FRONT, True)  # it cuts in: its rear is at the bumper


def test_track_beside_the_bumper_is_lateral(table: Make) -> None:
    assert verdict(table, {}, {"x": -0.1, "y": 1.9}) == (Impact.LATERAL, False)


def test_lateral_contact_out_of_the_lane_is_the_ego_s_fault(table: Make) -> None:
    assert verdict(table, {}, {"x": -0.1, "y": 1.9}, inside=False) == (Impact.LATERAL, True)


@pytest.mark.parametrize("turn", [0.0, 0.7, np.pi, -2.0])
def test_verdicts_turn_with_the_scene(table: Make, turn: float) -> None:
    cos, sin = np.cos(turn), np.sin(turn)
    for (x, y), expected in (((-3.8, 0.5), "rear"), ((3.8, 0.0), "front"), ((-0.1, 1.9), "lateral")):
        agent = {"x": x * cos - y * sin, "y": x * sin + y * cos, "yaw": turn}
        assert verdict(table, {"yaw": turn}, agent)[0] == expected


@pytest.mark.parametrize(("y", "at_fault"), [(-1.83, False), (-2.60, False), (-2.80, True)])
def test_lane_of_the_attached_net_decides(table: Make, make_run: Make, y: float, at_fault: bool) -> None:
    scene = table(1, {"id": 1, "x": 100.0, "y": y}, {"id": 2, "x": 99.9, "y": y - 1.9, "speed": 15.0})
    run = make_run([table(0), scene], net_xml=NET.read_bytes())
    (contact,) = collisions(run).ego
    assert (contact.verdict, contact.ego_at_fault) == (Impact.LATERAL, at_fault)


def test_without_a_net_lateral_contacts_are_the_ego_s_fault(table: Make, make_run: Make) -> None:
    scene = table(1, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": -0.1, "y": 1.9})
    assert collisions(make_run([table(0), scene])).ego[0].ego_at_fault


def test_what_is_behind_the_ego_is_seen_from_the_rear_axle_of_its_own_vehicle(table: Make, make_run: Make) -> None:
    run = make_run([table(k, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": -3.8, "y": 1.2}) for k in range(3)])
    for vehicle, expected in (("{}", Impact.REAR), ("{rear_axle: 0.5}", Impact.LATERAL)):
        made = replace(run, scenario_yaml=f"start_frame: 0\nvehicle: {vehicle}\n")
        assert [contact.verdict for contact in collisions(made).ego] == [expected]


def test_delta_v_is_half_the_difference_of_the_velocities(table: Make) -> None:
    scene = table(0, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 1.0, "y": 0.0, "speed": 15.0})
    assert judge(scene, 1, 2).delta_v == pytest.approx(2.5)
    scene = table(0, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 1.0, "y": 0.0, "yaw": np.pi / 2})
    assert judge(scene, 1, 2).delta_v == pytest.approx(0.5 * np.hypot(10, 10))


def test_a_pair_counts_once_however_long(table: Make, make_run: Make) -> None:
    apart = ({"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 4.0, "y": 0.0}, {"id": 3, "x": 50.0, "y": 0.0})
    close = (apart[0], apart[1] | {"x": 3.99, "controller": Controller.POLICY}, apart[2])
    run = make_run([table(0, *apart), *(table(k, *close) for k in (1, 2)), table(3, *apart), table(4, *close)], log=[])
    found = collisions(run)
    assert found.first == {(1, 2): 1}
    assert found.colliding == {1, 2}
    assert found.agents == {1, 2, 3}
    assert found.controlled == {2}


def test_log_s_own_contacts_are_the_floor(table: Make, make_run: Make) -> None:
    def scene(step: int, x3: float) -> Any:
        return table(step, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 3.0, "y": 0.0}, {"id": 3, "x": x3, "y": 0.0})

    run = make_run([scene(k, 6.0) for k in range(3)], log=[scene(k, 9.0) for k in range(3)])
    found = collisions(run)
    assert found.log == {(1, 2): 1}
    assert found.first == {(1, 2): 1, (2, 3): 1}
    assert found.excess == {(2, 3): 1}


def test_contacts_of_the_history_do_not_count(table: Make, make_run: Make) -> None:
    scene = [table(k, {"id": 1, "x": 0.0, "y": 0.0}, {"id": 2, "x": 3.0 + k, "y": 0.0}) for k in range(4)]
    assert collisions(make_run(scene, history_steps=0)).first == {}
    assert collisions(make_run(scene, log=scene, history_steps=0)).log == {}
    assert collisions(make_run(scene, history_steps=-1)).first == {(1, 2): 0}
