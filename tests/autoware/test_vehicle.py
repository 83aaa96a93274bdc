"""Motion of the rear axle, commands and trajectories, and the time of a stack, without ROS."""

from dataclasses import replace
from math import pi
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from litsim_autoware.messages.objects import lights_of
from litsim_autoware.messages.vehicle import RearAxle, command, future_of
from litsim_autoware.stack.profile import Profile, packaged_profiles
from litsim_autoware.stack.start_up import Call, StartUp
from litsim_autoware.stack.timeline import Timeline
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_NS
from litsim_sim.lane_map.signal_links import relation_id
from litsim_sim.scenario.scenario import Scenario, packaged


def test_a_steering_angle_turns_as_the_ego_reports_it() -> None:
    answer = command(4, acceleration=2.0, steering=0.1, speed=9.9, wheelbase=2.8)
    assert (answer.step, answer.acceleration) == (4, 2.0)
    turning = RearAxle(0.0, 0.0, 0.0, 10.0, 0.0, answer.yaw_rate)
    assert turning.steering(2.8) == pytest.approx(0.1)
    assert RearAxle(0.0, 0.0, 0.0, 0.05, 0.0, 0.0).steering(2.8) is None


def test_the_motion_between_steps_is_that_of_the_step_going_on() -> None:
    motion = RearAxle(0.0, 0.0, 0.0, 10.0, -2.0, pi)
    half = motion.after(0.5)
    assert (half.speed, half.yaw) == (9.0, pytest.approx(0.5 * pi))
    assert (half.x, half.y) == (pytest.approx(4.75 * np.cos(0.25 * pi)), pytest.approx(4.75 * np.sin(0.25 * pi)))
    assert motion.after(20.0).speed == 0.0


@pytest.mark.parametrize(("speed", "first"), [(0.0, -5.0), (10.0, -5.0), (10.0, 2.8)])
def test_a_trajectory_begins_at_the_ego_and_goes_as_fast_as_it_says(speed: float, first: float) -> None:
    points = np.column_stack([first + np.arange(105.0), np.zeros(105)])
    future = future_of(points, np.full(105, 10.0), RearAxle(2.3, 0.1, 0.0, speed, 0.0, 0.0), 1.4, 5.0)
    assert future[:, 0] == pytest.approx(np.arange(1, 51) * 0.1)
    assert future[:, 2] == pytest.approx(np.zeros(50))
    assert np.all(np.diff(future[:, 1]) > 0.0)
    if speed:
        assert future[:, 1] == pytest.approx(2.3 + 1.4 + 10.0 * future[:, 0], abs=0.01)


def test_a_trajectory_that_ends_with_a_stop_is_held_there() -> None:
    points, speeds = np.column_stack([np.arange(11.0), np.zeros(11)]), np.linspace(4.0, 0.0, 11)
    future = future_of(points, speeds, RearAxle(0.0, 0.0, 0.0, 4.0, 0.0, 0.0), 0.0, 30.0)
    assert future[-1, 1] == pytest.approx(10.0, abs=0.1)
    assert np.diff(future[:, 1]).max() <= 0.4 + 1e-6


def test_time_passes_before_the_run_and_stamps_name_steps() -> None:
    timeline = Timeline()
    assert timeline.step_of(10**12) == -1
    timeline.release(12_340_000_000)
    assert timeline.stamp(0) == 12_400_000_000
    stamps = {12_399_000_001: 0, 12_300_000_000: -1, 12_400_000_000: 0, 12_470_000_000: 0, 12_500_000_000: 1}
    assert {stamp: timeline.step_of(stamp) for stamp in stamps} == stamps
    assert timeline.stamp(7) - timeline.stamp(0) == 7 * STEP_NS


class Service:
    """A service that answers at the second poll, with what it was given, the last again and again."""

    def __init__(self, name: str, log: list[str], *responses: tuple[bool, int]) -> None:
        self.name, self.log, self.responses, self.there = name, log, list(responses), True

    def call(self) -> Any:
        self.log.append(self.name)
        success, code = self.responses.pop(0) if len(self.responses) > 1 else self.responses[0]
        status = SimpleNamespace(success=success, code=code, message="" if success else "not now")
        return SimpleNamespace(done=lambda: True, result=lambda: SimpleNamespace(status=status))


def started(*services: Service) -> StartUp:
    return StartUp({each.name: Call(f"/{each.name}", lambda each=each: each.there, each.call) for each in services})


def test_services_are_called_in_order_until_each_agrees() -> None:
    log: list[str] = []
    engage = Service("engage", log, (True, 0))
    engage.there = False
    start_up = started(Service("initialize", log, (False, 7), (True, 0)), Service("set_route", log, (True, 0)), engage)
    start_up.poll(0.0)
    start_up.poll(0.01)
    assert start_up.waiting == "/initialize: not now (code 7)"
    for poll in range(40):
        start_up.poll(0.1 * poll)
    assert (log, start_up.waiting) == (["initialize", "initialize", "set_route"], "service /engage")
    engage.there = True
    for poll in range(40, 44):
        start_up.poll(0.1 * poll)
    assert start_up.done and log[-1] == "engage"


def test_a_route_that_is_set_already_is_cleared() -> None:
    log: list[str] = []
    services = (Service("clear_route", log, (False, 3)), Service("set_route", log, (False, 1), (True, 0)))
    start_up = started(*services)
    for poll in range(40):
        start_up.poll(0.1 * poll)
    assert start_up.done
    assert log == ["set_route", "clear_route", "set_route"]


def test_lights_have_the_ids_of_relations_of_exported_and_of_imported_maps() -> None:
    scenario = Scenario.load(str(packaged("suites/small/street_14.yaml", "litsim_eval")))
    assert scenario.signals is not None
    ids, groups = lights_of(scenario.signals)
    by_link = {
        relation_id(link.name): group
        for link, group in zip(scenario.signals.links, scenario.signals.link_group, strict=True)
    }
    assert dict(zip(ids.tolist(), groups.tolist(), strict=True)) == by_link
    named = replace(scenario.signals, groups=("7023", *scenario.signals.groups[1:]))
    ids, groups = lights_of(named)
    assert dict(zip(ids.tolist(), groups.tolist(), strict=True)) == by_link | {7023: 0}
    assert [len(each) for each in lights_of(None)] == [0, 0]


def test_profiles(tmp_path: Any) -> None:
    assert packaged_profiles() == ("core", "universe")
    core = Profile.load("core")
    assert (core.answers, core.starts_in) == ("control", "autonomous")
    assert core.engage is None  # no node of Core serves a change of the operation mode
    own = tmp_path / "own.yaml"
    own.write_text("description: mine\nstarts_in: sometimes\n")
    with pytest.raises(InputError, match=r"own.yaml: .*starts_in"):
        Profile.load(str(own))
