"""Who answers for a contact, in scenes made by hand of which the fault is known, on the packaged nets."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import litsim_sim
from litsim_eval.analysis.measures import blame
from litsim_eval.analysis.measures.blame import Cause, Side
from litsim_eval.analysis.measures.fault import contact_verdicts
from litsim_eval.analysis.measures.signals import Passage
from litsim_sim.core.scene import Controller, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.lane_map import LaneMap
from made_runs import make_run, table

Motion = Callable[[int], tuple[float, ...]]
NETS = Path(litsim_sim.__file__).parent / "nets"
LANES = (-1.83, -5.49)  # [m] centres of the leftmost lanes of us101_like
EGO, OTHER, THIRD, STEPS = 1, 2, 3, 100


def along(x: float, speed: float, lane: float = LANES[0], braking: float = 0.0, since: int = 0) -> Motion:
    """Straight on at a speed [m/s], braking [m/s2] since a step."""

    def state(k: int) -> tuple[float, ...]:
        t = 0.1 * max(0, k - since)
        t = min(t, speed / braking) if braking else t
        gone = 0.1 * speed * min(k, since) + speed * t - 0.5 * braking * t**2
        return x + gone, lane, 0.0, speed - braking * t

    return state


def sideways(motion: Motion, to: float, begin: int, steps: int) -> Motion:
    """The same, to another y [m] within some steps."""

    def state(k: int) -> tuple[float, ...]:
        x, y, _, speed = motion(k)
        share = float(np.clip((k - begin) / steps, 0.0, 1.0))
        slope = (to - y) / (0.1 * steps) if 0.0 < share < 1.0 else 0.0
        return x, y + share * (to - y), float(np.arctan2(slope, speed)), float(np.hypot(slope, speed))

    return state


def scene(*motions: Motion, net: str = "us101_like", **more: Any) -> Any:
    """A run in which the ego and others move as told; in the log they are far from each other."""
    names = ("x", "y", "yaw", "speed")

    def rows(k: int, apart: float) -> list[dict[str, Any]]:
        states = [{"id": EGO + n, **dict(zip(names, motion(k), strict=True))} for n, motion in enumerate(motions)]
        return [{**state, "y": state["y"] + apart * n, **(more if n == 1 else {})} for n, state in enumerate(states)]

    tables, log = ([table(k, *rows(k, apart)) for k in range(STEPS + 1)] for apart in (0.0, 500.0))
    return make_run(tables, log, history_steps=0, net_xml=(NETS / f"{net}.net.xml").read_bytes())


def answer(run: Any) -> tuple[str, str, bool]:
    """Cause of the first contact, who created it, and whether the ego answers for it."""
    blamed = contact_verdicts(run)[0].blame
    return blamed.cause, blamed.by, blamed.of_ego


LEFT, RIGHT = LANES
CASES: dict[str, tuple[Sequence[Motion], tuple[Cause, Side, bool]]] = {
    "another swerves into the flank": (
        [along(100, 10), sideways(along(98, 10, RIGHT), LEFT, 40, 20)],
        (Cause.ENTERED, Side.OTHER, False),
    ),
    "another swerves into the flank of an ego that could have let it in": (
        [along(100, 10), sideways(along(103, 9.5, RIGHT), LEFT, 20, 60)],
        (Cause.ENTERED, Side.OTHER, False),
    ),
    "another cuts in too close": (
        [along(100, 20), sideways(along(110, 10, RIGHT), LEFT, 5, 8)],
        (Cause.ENTERED, Side.OTHER, False),
    ),
    "another cuts in, and the ego does not brake": (
        [along(100, 12), sideways(along(120, 8, RIGHT), LEFT, 10, 30)],
        (Cause.ENTERED, Side.OTHER, True),
    ),
    "the leader changes lane just before a car that stands": (
        [along(100, 14), along(172, 0), sideways(along(112, 14), RIGHT, 28, 10)],
        (Cause.REVEALED, Side.NEITHER, False),
    ),
    "the leader changes lane early before a car that stands": (
        [along(100, 8), along(180, 0), sideways(along(112, 14), RIGHT, 15, 10)],
        (Cause.STANDING, Side.EGO, True),
    ),
    "the ego brakes late": (
        [along(100, 12, braking=4.0, since=50), along(120, 12, braking=3.0, since=20)],
        (Cause.FOLLOWED, Side.EGO, True),
    ),
    "the leader brakes too hard for an ego that is too close": (
        [along(100, 15), along(108, 15, braking=8.0, since=20)],
        (Cause.FOLLOWED, Side.EGO, True),
    ),
    "the ego squeezes past a car that stands": (
        [sideways(along(100, 6), LEFT + 1.2, 15, 20), along(130, 0)],
        (Cause.STANDING, Side.EGO, True),
    ),
    "another runs into the ego from behind": (
        [along(100, 8, braking=2.0, since=20), along(80, 9)],
        (Cause.FOLLOWED, Side.OTHER, False),
    ),
    "another runs into the standing ego": ([along(150, 0), along(80, 12)], (Cause.STANDING, Side.OTHER, False)),
    "another cuts the corner of the ego that has just stopped": (
        [along(100, 4, braking=4.0, since=20), sideways(along(86, 7, RIGHT), LEFT, 20, 25)],
        (Cause.FOLLOWED, Side.OTHER, False),
    ),
    "the ego swerves into another": (
        [sideways(along(100, 10), RIGHT, 40, 15), along(100, 10, RIGHT)],
        (Cause.ENTERED, Side.EGO, True),
    ),
    "the ego cuts in right in front of another": (
        [sideways(along(100, 8), RIGHT, 20, 10), along(85, 14, RIGHT)],
        (Cause.ENTERED, Side.EGO, True),
    ),
    "the ego cuts in, and the other could have braked": (
        [sideways(along(100, 11), RIGHT, 20, 30), along(80, 14, RIGHT)],
        (Cause.ENTERED, Side.EGO, False),
    ),
    "the ego cuts in and stops, long before it is hit": (
        [sideways(along(150, 8, braking=2.0, since=30), RIGHT, 5, 15), along(70, 14, RIGHT)],
        (Cause.FOLLOWED, Side.OTHER, False),
    ),
    "another merges into the corner of an ego that stands in its lane, and could have stood farther back": (
        [along(100, 4, braking=4.0, since=0), sideways(along(78, 4.5, RIGHT), LEFT - 1.4, 0, 50)],
        (Cause.STANDING, Side.OTHER, False),
    ),
    "a car stands right ahead when the ego begins to drive": (
        [along(100, 15), along(115, 0)],
        (Cause.START, Side.NEITHER, False),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_on_a_road(name: str) -> None:
    motions, expected = CASES[name]
    assert answer(scene(*motions)) == expected


def test_an_ego_in_its_lane_does_not_answer_for_one_that_comes_head_on() -> None:
    def comes(k: int) -> tuple[float, ...]:
        return 200.0 - k, LEFT, np.pi, 10.0

    ahead = along(100, 10)
    assert answer(scene(ahead, comes)) == (Cause.WRONG_WAY, Side.OTHER, False)
    assert answer(scene(comes, ahead)) == (Cause.WRONG_WAY, Side.EGO, True)


@pytest.fixture(scope="module")
def street() -> LaneMap:
    return LaneMap.from_net(NETS / "urban_like.net.xml")


def through(street: LaneMap, lane: str, speed: float, steps: int) -> Motion:
    """Along the lanes that begin with one, at a speed [m/s], so that its middle is passed after some steps."""
    row = street.row(lane)
    middle = 0.5 * street.lanes[row].length
    (before,) = (each for each in street.lanes if lane in each.successors)
    path = np.concatenate([before.centerline, street.path_from(row, 0.0, 100.0)])
    length = np.append(0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T)))

    def state(k: int) -> tuple[float, ...]:
        s = before.length + middle + 0.1 * speed * (k - steps)
        (x, y), (dx, dy) = ([np.interp(s + ds, length, path[:, axis]) for axis in (0, 1)] for ds in (0.0, 0.5))
        return float(x), float(y), float(np.arctan2(dy - y, dx - x)), speed

    return state


HIDDEN_STEPS = {6.0: 40, 1.5: 68}  # until the other is in the middle of the junction, by the speed of the ego
TURNS, COMES = ":A_6_0", ":A_11_0"  # to the left across the other, and straight on with right of way


def test_right_of_way(street: LaneMap) -> None:
    turn, straight = through(street, TURNS, 6.0, 18), through(street, COMES, 9.0, 40)
    assert answer(scene(turn, straight, net="urban_like")) == (Cause.RIGHT_OF_WAY, Side.EGO, True)
    cause, by, _ = answer(scene(straight, turn, net="urban_like"))
    assert (cause, by) == (Cause.RIGHT_OF_WAY, Side.OTHER)


def show(monkeypatch: pytest.MonkeyPatch, states: dict[int, SignalState]) -> None:
    """Has agents pass stop lines at step 25, at which lights show them `states`."""
    passed = [Passage(agent, 25, "a", "a", state, Controller.LOG) for agent, state in states.items()]
    monkeypatch.setattr(blame, "run_passages", lambda _: passed)


PERMISSIVE, GREEN, DARK = SignalState.GREEN_PERMISSIVE, SignalState.GREEN, SignalState.DARK


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        ({EGO: PERMISSIVE, OTHER: GREEN}, (Cause.RIGHT_OF_WAY, Side.EGO)),
        ({EGO: SignalState.AMBER_PERMISSIVE, OTHER: GREEN}, (Cause.RIGHT_OF_WAY, Side.EGO)),
        ({EGO: GREEN, OTHER: GREEN}, (Cause.CROSSING, Side.NEITHER)),  # an arrow, whatever the signs say
        ({OTHER: GREEN}, (Cause.RIGHT_OF_WAY, Side.EGO)),  # the ego's way has no light
        ({EGO: DARK, OTHER: DARK}, (Cause.RIGHT_OF_WAY, Side.EGO)),
        ({EGO: GREEN, OTHER: PERMISSIVE}, (Cause.RIGHT_OF_WAY, Side.OTHER)),
    ],
)
def test_lights_and_signs(street: LaneMap, monkeypatch, states, expected) -> None:
    """Each has right of way by its own light, where it has one that works, else by the signs of the net."""
    show(monkeypatch, states)
    turn, straight = through(street, TURNS, 6.0, 18), through(street, COMES, 9.0, 40)
    assert answer(scene(turn, straight, net="urban_like"))[:2] == expected


def test_red_is_no_cause_among_those_of_one_lane(monkeypatch) -> None:
    """An ego that has stopped beyond the line at red is hit by the one behind: nobody crosses."""
    show(monkeypatch, {EGO: SignalState.RED})
    run = scene(along(100, 8, braking=4.0, since=10), along(60, 9))
    assert answer(run) == (Cause.STANDING, Side.OTHER, False)


@pytest.mark.parametrize(
    ("speed", "steps", "expected"),
    [(6.0, 18, (Cause.RIGHT_OF_WAY, Side.EGO, True)), (1.5, 0, (Cause.REVEALED, Side.NEITHER, False))],
)
def test_who_turns_past_vehicles_that_hide_others(
    street: LaneMap, speed: float, steps: int, expected: tuple[Cause, Side, bool]
) -> None:
    """Who has to give way, and cannot see, is excused only if it feels its way."""
    queue = [lambda _, x=x: (x, -5.0, 0.0, 0.0) for x in np.arange(-104.5, -140.0, -5.0)]
    turn, straight = through(street, TURNS, speed, steps), through(street, COMES, 12.0, HIDDEN_STEPS[speed])
    assert answer(scene(turn, straight, *queue, net="urban_like")) == expected


@pytest.mark.parametrize("runs_red", [EGO, OTHER])
def test_red_light(street: LaneMap, monkeypatch, runs_red: int) -> None:
    """Two cross, one of which had red, too late for a careful driver to do anything; neither saw the other before."""
    motions = through(street, ":A_11_0", 10.0, 40), through(street, ":A_1_0", 14.0, 32)
    states = {agent: SignalState.RED if agent == runs_red else SignalState.GREEN for agent in (EGO, OTHER)}
    show(monkeypatch, states)
    monkeypatch.setattr(blame, "hidden", lambda _, ego, __: np.ones(len(ego), np.bool_))
    cause, by, of_ego = answer(scene(*motions, net="urban_like"))
    assert (cause, by) == (Cause.RED_LIGHT, Side.EGO if runs_red == EGO else Side.OTHER)
    assert of_ego or runs_red == OTHER


@pytest.mark.parametrize(("begin", "steps", "of_ego"), [(0, 60, True), (42, 14, False)])
def test_who_steps_in_front_of_the_ego(begin: int, steps: int, of_ego: bool) -> None:
    walker = sideways(along(160, 0, LANES[0] - 5.0), LANES[0], begin, steps)
    run = scene(along(100, 10), walker, kind=Kind.PEDESTRIAN, length=0.6, width=0.6)
    assert answer(run) == (Cause.WALKER, Side.NEITHER, of_ego)
