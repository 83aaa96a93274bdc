"""Who answers for a contact of the ego: who created the situation, and what a careful driver could do from there.

Whoever creates a situation answers for it; the other one only if a careful driver in its place, who reacts once the
situation can be seen, avoids the contact. The rules are our choice; they follow traffic law (who changes lane, turns
across or enters gives way; who follows keeps a distance) and, for what the driver can do, UN Regulation 157.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from litsim_eval.analysis.careful_driver import LOOK_BACK_S, OVER_S, TTC_S, CarefulDriver, hidden
from litsim_eval.analysis.measures.collision import STOPPED_SPEED, EgoContact, Impact
from litsim_eval.analysis.measures.road_rules import on_wrong_side
from litsim_eval.analysis.measures.signals import run_passages
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import AgentRows, BoolArray, FloatArray, IntArray
from litsim_sim.core.signals import STOP_STATES, SignalState
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

STANDS_MPS = 0.3  # [m/s] up to which a vehicle stands
ENTERING_S = 3.0  # [s] that entering takes at most; before the contact in which one enters, or ways cross
ENTERED_M = 0.3  # [m] to the side from which on a vehicle has entered the other's way
CROSSING_RAD = np.deg2rad(45.0)  # between headings from which on ways cross
NEAR_WAY_M = 15.0  # [m] from the other's way within which headings count
LIGHT_S = 10.0  # [s] before the contact in which a light counts
WALKING_MPS = 2.0  # [m/s] of who feels its way into a junction that it cannot overlook
GIVE_WAY_STATES = (SignalState.GREEN_PERMISSIVE, SignalState.AMBER_PERMISSIVE, SignalState.FLASHING_RED)
SIGN_STATES = (None, SignalState.UNAVAILABLE, SignalState.DARK, SignalState.FLASHING_AMBER)
"""What lights show where signs decide; None for who has passed none."""
FAR_M = 100.0  # [m] by which a way is prolonged, straight


class Cause(StrEnum):
    """What led to a contact, in the order in which it is tested; the last two excuse an ego that created it."""

    WALKER = "walker"  # a pedestrian or cyclist
    RED_LIGHT = "red_light"  # ways cross, and one passed a stop line at red
    STANDING = "standing"  # one ran into another that had stood for TTC_S
    WRONG_WAY = "wrong_way"  # ways cross, and one was on a lane that leads the other way
    RIGHT_OF_WAY = "right_of_way"  # one had to give way in a junction
    CROSSING = "crossing"  # ways cross, and no rule is known
    ENTERED = "entered"  # one came into the other's way from the side
    FOLLOWED = "followed"  # one ran into the other, which was ahead
    REVEALED = "revealed"  # the other was hidden by a third vehicle until just before, and no light was red
    START = "start"  # the risk was there when the ego began to drive, or the other appeared


class Side(StrEnum):
    """Who created a situation."""

    EGO = "ego"
    OTHER = "other"
    NEITHER = "neither"


@dataclass(frozen=True)
class Blame:
    """Why a contact of the ego came about.

    Attributes:
        cause: what led to it.
        by: who created the situation.
        of_ego: whether it counts against the ego.
    """

    cause: Cause
    by: Side
    of_ego: bool


def blame(run: Run, contact: EgoContact, own: CarefulDriver, other: CarefulDriver | None) -> Blame:
    """Returns who answers for a contact.

    If the ego created the situation, it answers, unless it came into the way of a vehicle that then ran into it, from
    behind or where it stood, and could have avoided that. Otherwise it answers if the careful driver in its place
    avoids the contact, by braking: this is asked only of an ego that moves, and where ways do not cross only if all of
    the other is ahead of it when that driver perceives the risk, as in the regulation.

    That a third vehicle hid the other excuses nobody at red, and of those who have to give way only who feels its way,
    at walking speed: they must be able to stop for who may come (Vienna Convention on Road Traffic, article 18.1).

    Args:
        run: with the contact.
        contact: of the ego, by nuPlan's attribution.
        own, other: verdicts on the careful driver in place of the ego and of the other; None for a pedestrian.
    """
    pair = _Encounter.of(run, contact)
    cause, by = (Cause.WALKER, Side.NEITHER) if other is None else pair.created_by(run)
    if by == Side.EGO and cause != Cause.ENTERED:
        if pair.revealed(own.perceived_step) and pair.may_not_have_seen(cause, own.perceived_step):
            cause, by = Cause.REVEALED, Side.NEITHER
        elif pair.at_once(own.perceived_step):
            cause, by = Cause.START, Side.NEITHER
    if by == Side.EGO:
        late = cause in (Cause.ENTERED, Cause.RIGHT_OF_WAY) and contact.verdict in (Impact.REAR, Impact.STOPPED_EGO)
        return Blame(cause, by, of_ego=not (late and other is not None and other.avoided))
    beside = cause in (Cause.ENTERED, Cause.FOLLOWED) and not pair.ahead_at(own.perceived_step)
    of_ego = own.avoided and not beside and cause != Cause.STANDING
    if cause == Cause.WALKER:
        of_ego = contact.ego_at_fault and (own.avoided or pair.in_way_s >= TTC_S)
    elif cause == Cause.CROSSING:
        of_ego |= contact.ego_at_fault
    return Blame(cause, by, of_ego)


@dataclass(frozen=True)
class _Encounter:
    """The ego and another agent before their contact.

    Attributes:
        step: (m,) at which both are there, up to the contact.
        ego, other: (m,) their states.
        dt: [s].
        lane_map: lanes; None without a net.
        unseen: (m,) whether a third vehicle hides the other from the ego.
    """

    step: IntArray
    ego: AgentRows
    other: AgentRows
    dt: float
    lane_map: LaneMap | None
    unseen: BoolArray

    @classmethod
    def of(cls, run: Run, contact: EgoContact) -> _Encounter:
        """Returns the encounter that ends with a contact."""
        whole, dt = run.simulated, run.info.dt
        begin, end = whole.step.searchsorted([contact.step - round(LOOK_BACK_S / dt), contact.step + 1]).tolist()
        steps = whole.part(begin, end)
        rows = steps.rows_of(np.array([run.info.ego_id, contact.agent]))
        there = rows.min(axis=1) >= 0
        ego, other = rows[there].T
        table = steps.stacked
        unseen = hidden(steps, ego, other)
        return cls(steps.step[there], table.take(ego), table.take(other), dt, lane_map_of(run), unseen)

    def created_by(self, run: Run) -> tuple[Cause, Side]:
        """Returns what led to the contact of two vehicles, and who created the situation."""
        crosses, shown = self._crosses, self._shown(run)
        if crosses and (by := self._alone([state in STOP_STATES for state in shown])):
            return Cause.RED_LIGHT, by
        recent = slice(-round(TTC_S / self.dt) - 1, None)
        moved = [bool((agent.speed[recent] > STANDS_MPS).any()) for agent in (self.ego, self.other)]
        if by := self._alone(moved):
            return Cause.STANDING, by
        if crosses:
            if by := self._alone(self._on_wrong_side()):
                return Cause.WRONG_WAY, by
            if by := self._alone(self._give_way(shown)):
                return Cause.RIGHT_OF_WAY, by
            return Cause.CROSSING, Side.NEITHER
        entrant = self._entrant()
        by = entrant or self._behind
        stopped = (self.ego if self._behind == Side.EGO else self.other).speed[-1] <= STOPPED_SPEED
        if not entrant and stopped:  # who has stopped runs into nobody
            by = Side.OTHER if self._behind == Side.EGO else Side.EGO
        return (Cause.ENTERED if entrant else Cause.FOLLOWED), by

    def revealed(self, perceived_step: int) -> bool:
        """Returns whether the other had been hidden until just before a step."""
        just_before = (self.step < perceived_step) & (self.step >= perceived_step - round(OVER_S / self.dt))
        return bool(self.unseen[just_before].any())

    def may_not_have_seen(self, cause: Cause, step: int) -> bool:
        """Returns whether it excuses the ego, at a step, that it could not see the other before."""
        row = min(int(self.step.searchsorted(step)), len(self.step) - 1)
        feels_its_way = bool(self.ego.speed[row] <= WALKING_MPS)
        return cause != Cause.RED_LIGHT and (cause != Cause.RIGHT_OF_WAY or feels_its_way)

    def at_once(self, perceived_step: int) -> bool:
        """Returns whether a step is the first at which both are there, and the ego drives."""
        return perceived_step <= int(self.step[0]) and len(self.step) * self.dt <= LOOK_BACK_S

    def ahead_at(self, step: int) -> bool:
        """Returns whether all of the other was ahead of the ego's front at a step."""
        row = min(int(self.step.searchsorted(step)), len(self.step) - 1)
        ahead, _ = to_body(self.other.x - self.ego.x, self.other.y - self.ego.y, self.ego.yaw)
        return bool(ahead[row] > 0.5 * (self.ego.length[row] + self.other.length[row]))

    @property
    def in_way_s(self) -> float:
        """Time before the contact from which on the one ahead has been in the way of the one behind [s]."""
        return float((self.step[-1] - self.step[self._in_way]) * self.dt)

    @staticmethod
    def _alone(of_ego_and_other: list[bool]) -> Side | None:
        """Returns the only one of both for which something is true; None for neither or both."""
        ego, other = of_ego_and_other
        return None if ego == other else Side.EGO if ego else Side.OTHER

    def _shown(self, run: Run) -> list[SignalState | None]:
        """Returns what the signals showed to the ego, and to the other, when they last passed a stop line."""
        end, begin = int(self.step[-1]), int(self.step[-1]) - round(LIGHT_S / self.dt)
        passed = {
            passage.agent: passage.state for passage in run.once(run_passages) or () if begin <= passage.step <= end
        }
        return [passed.get(int(agent.id[-1])) for agent in (self.ego, self.other)]

    def _on_wrong_side(self) -> list[bool]:
        """Returns whether the ego, and the other, was on a lane against its direction at the contact."""
        if self.lane_map is None:
            return [False, False]
        x, y, yaw = (np.array([getattr(of, name)[-1] for of in (self.ego, self.other)]) for name in ("x", "y", "yaw"))
        wrong, _ = on_wrong_side(self.lane_map, x, y, yaw)
        return wrong.tolist()

    def _give_way(self, shown: Sequence[SignalState | None]) -> list[bool]:
        """Returns whether the ego, and the other, had to give way: by the light `shown` to it, else by signs."""
        of_map = self.lane_map
        minor = set() if of_map is None else {of_map.row(name) for lane in of_map.lanes for name in lane.gives_way}
        by_sign = [bool(minor & {*self._lanes(of)[0].tolist()}) for of in (self.ego, self.other)]
        return [
            sign if state in SIGN_STATES else state in GIVE_WAY_STATES
            for state, sign in zip(shown, by_sign, strict=True)
        ]

    def _lanes(self, of: AgentRows) -> tuple[IntArray, FloatArray]:
        """Returns the lanes (m,) that an agent is on, and their headings; -1 and its first heading without a net."""
        if self.lane_map is None:
            return np.full(len(of), -1), np.full(len(of), of.yaw[0])
        place = self.lane_map.nearest(of.x, of.y, of.yaw)
        return place.lane, place.heading

    @property
    def _behind(self) -> Side:
        """Who is behind at the contact, along the mean of both headings."""
        headings = np.exp(1j * self.ego.yaw[-1]) + np.exp(1j * self.other.yaw[-1])
        apart = complex(self.other.x[-1] - self.ego.x[-1], self.other.y[-1] - self.ego.y[-1])
        return Side.EGO if (apart * np.conj(headings)).real > 0.0 else Side.OTHER

    @property
    def _along(self) -> tuple[FloatArray, FloatArray]:
        """(m,) how far the one ahead is to the left of the way of the one behind [m], and the heading there."""
        behind, ahead = (self.ego, self.other) if self._behind == Side.EGO else (self.other, self.ego)
        return _beside(behind, ahead)

    @property
    def _in_way(self) -> int:
        """First index from which on the one ahead is in the way of the one behind until the contact."""
        left, _ = self._along
        out = (np.abs(left) >= 0.5 * (self.ego.width + self.other.width)).nonzero()[0]
        return min(int(out[-1]) + 1, len(left) - 1) if len(out) else 0

    @property
    def _crosses(self) -> bool:
        """Whether the ways crossed or merged at an angle just before the contact."""
        left, heading = self._along
        ahead = self.other if self._behind == Side.EGO else self.ego
        near = (np.abs(left) < NEAR_WAY_M) & (self.step[-1] - self.step <= ENTERING_S / self.dt)
        return bool((np.abs(wrap_angle(ahead.yaw - heading))[near] > CROSSING_RAD).any())

    def _entrant(self) -> Side | None:
        """Returns who came into the other's way from the side; None where one was ahead for long."""
        inside, (left, _) = self._in_way, self._along
        if inside == 0 or self.in_way_s > ENTERING_S:
            return None
        of_ego = 1.0 if self._behind == Side.EGO else -1.0
        side = of_ego * np.sign(left[inside - 1])  # of the ego on which the other is
        came = slice(max(0, inside - round(ENTERING_S / self.dt)), inside + 1)
        ego, other = (float(across[came].sum()) for across in map(self._across, (self.ego, self.other)))
        towards = {Side.EGO: side * ego, Side.OTHER: -side * other}
        most = max(towards, key=lambda of: towards[of])
        return most if towards[most] >= ENTERED_M else None

    def _across(self, of: AgentRows) -> FloatArray:
        """Returns how far (m,) an agent has moved to the left of its lane's direction since the step before [m]."""
        _, heading = self._lanes(of)
        _, left = to_body(np.diff(of.x, prepend=of.x[0]), np.diff(of.y, prepend=of.y[0]), heading)
        return left


def _beside(behind: AgentRows, ahead: AgentRows) -> tuple[FloatArray, FloatArray]:
    """Returns how far an agent (m,) is to the left of the way of another (m,) [m], and how that headed there [rad].

    The way is prolonged straight at both ends.
    """
    points = np.column_stack([behind.x, behind.y])
    moved = np.append(True, np.hypot(*np.diff(points, axis=0).T) > 0.0)
    ends = np.column_stack([np.cos(behind.yaw[[0, -1]]), np.sin(behind.yaw[[0, -1]])]) * FAR_M
    way = np.concatenate([points[:1] - ends[:1], points[moved], points[-1:] + ends[1:]])
    parts = np.diff(way, axis=0)
    to = np.column_stack([ahead.x, ahead.y])[:, None] - way[:-1]
    share = np.clip((to * parts).sum(axis=2) / (parts**2).sum(axis=1), 0.0, 1.0)
    away = to - share[:, :, None] * parts
    nearest = np.hypot(away[:, :, 0], away[:, :, 1]).argmin(axis=1)
    direction = np.arctan2(parts[nearest, 1], parts[nearest, 0])
    offset = to[np.arange(len(to)), nearest]
    _, left = to_body(offset[:, 0], offset[:, 1], direction)
    return left, np.append(behind.yaw[:1], behind.yaw[moved])[nearest]
