"""Changes of a scenario: what one wants to know of that was not recorded, such as an agent that brakes.

An agent that brakes, cuts in or out, crosses, drives at another pace or enters at another time is an *actor*: the
world drives it off its log for a time (:mod:`litsim_sim.world.actors`), while all others react as they always do. After
that it is the policy's, which brings it back to its log; in pure replay it returns by itself. What the ego is told of
others may differ, too (:mod:`litsim_sim.scenario.perception`).

An act begins at a time, or later, once the agent has a headway to the ego: it happens where the ego is in the run, as
by the conditions of OpenSCENARIO (`TimeHeadwayCondition`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    TypeAdapter,
    field_validator,
    model_serializer,
)

from litsim_sim.core.geometry import smooth_step
from litsim_sim.core.scene import STEP_S, IntArray
from litsim_sim.scenario.recording import BOUNDS, Recording

ENTRY_S = 5.0
"""Time after its entry for which an agent that enters at another time is driven, as an actor, along its shifted log
[s]."""

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Time = Annotated[float, Field(ge=0.0, le=86_400.0, allow_inf_nan=False)]
_Duration = Annotated[float, Field(ge=STEP_S, le=3600.0, allow_inf_nan=False)]
_Headway = Annotated[float, Field(ge=0.0, le=60.0, allow_inf_nan=False)]


class _Change(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    sentence: ClassVar[str]  # format string of the fields

    @property
    def text(self) -> str:
        """The change as a sentence."""
        return self.sentence.format(**dict(self))


class _Waiting(_Change):
    """What an agent begins at a time, or once it is so near to the ego.

    Attributes:
        begin_s: when, from step 0 on [s].
        headway_s: least and greatest headway of the ego to the agent with which the act begins, at `begin_s` or later,
            while the agent is where the act concerns the ego; the agent stays on its log if that never comes. None:
            it begins at `begin_s`, wherever both are.
    """

    begin_s: _Time
    headway_s: Annotated[tuple[_Headway, _Headway], Field(strict=False)] | None = None

    @field_validator("headway_s")
    @classmethod
    def _ascends(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and value[0] >= value[1]:
            raise ValueError(f"least {value[0]:g} s, greatest {value[1]:g} s, expected the least first")
        return value

    @model_serializer(mode="wrap")
    def _without_none(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leaves a missing headway out: so identities stay those of versions that did not have it."""
        return {name: value for name, value in handler(self).items() if value is not None}

    @property
    def text(self) -> str:
        """The change as a sentence."""
        if self.headway_s is None:
            return super().text
        least, greatest = self.headway_s
        return f"{super().text}, once {least:.2f} to {greatest:.2f} s ahead of the ego"


class _Act(_Change):
    """What an agent does for a time.

    Attributes:
        agent: its id.
        begin_s, duration_s: when, from step 0 on, and for how long [s].
    """

    kind: str
    agent: int
    begin_s: _Time
    duration_s: _Duration


class Brake(_Waiting, _Act):
    """An agent brakes on its logged path; it waits for an ego behind it in its lane.

    Attributes:
        deceleration: how hard [m/s2].
    """

    kind: Literal["brake"]
    sentence = "{agent} brakes at {deceleration:.2f} m/s² for {duration_s:.1f} s from {begin_s:.1f} s on"
    deceleration: Annotated[_Finite, Field(gt=0.0, le=8.0)]


class LaneChange(_Waiting, _Act):
    """An agent changes to a lane beside it, at the speed of its log, and stays there for as long again."""


class CutIn(LaneChange):
    """A change to the lane on the ego's side; the agent waits for an ego behind it in the lane beside."""

    kind: Literal["cut_in"]
    sentence = "{agent} cuts in within {duration_s:.1f} s from {begin_s:.1f} s on"


class CutOut(LaneChange):
    """A change to the left lane, else to the right one; the agent waits for the same ego as in :class:`Brake`."""

    kind: Literal["cut_out"]
    sentence = "{agent} cuts out within {duration_s:.1f} s from {begin_s:.1f} s on"


class Pace(_Act):
    """An agent drives on its logged path at a multiple of the speed that it had there.

    Attributes:
        factor: of the logged speed.
    """

    kind: Literal["pace"]
    sentence = "{agent} drives at {factor:.2f} times its recorded speed for {duration_s:.1f} s from {begin_s:.1f} s on"
    factor: Annotated[_Finite, Field(ge=0.0, le=3.0)]


class Cross(_Waiting):
    """A pedestrian or cyclist goes straight on until the run ends; it waits for an ego that it is in front of.

    Attributes:
        agent: its id.
        speed: that it takes up [m/s].
    """

    kind: Literal["cross"]
    sentence = "{agent} crosses at {speed:.1f} m/s from {begin_s:.1f} s on"
    agent: int
    speed: Annotated[_Finite, Field(gt=0.0, le=10.0)]


class Hide(_Act):
    """The ego is not told of an agent for a time: a drop-out, or an agent that is seen late."""

    kind: Literal["hide"]
    sentence = "the ego is not told of {agent} for {duration_s:.1f} s from {begin_s:.1f} s on"


class Inattentive(_Change):
    """The driver of an agent reacts later: while the policy drives it, its accelerations take effect later.

    Attributes:
        agent: its id.
        later_s: how much, whole steps [s].
    """

    kind: Literal["inattentive"]
    sentence = "{agent} reacts {later_s:.1f} s later"
    agent: int
    later_s: Annotated[_Finite, Field(ge=0.0, le=5.0, multiple_of=STEP_S)]


class Enter(_Change):
    """An agent enters at another time.

    Attributes:
        agent: its id.
        later_s: how much later it enters; earlier if negative [s].
    """

    kind: Literal["enter"]
    agent: int
    later_s: Annotated[_Finite, Field(ge=-60.0, le=60.0)]

    @property
    def text(self) -> str:
        """The change as a sentence."""
        return f"{self.agent} enters {abs(self.later_s):.1f} s {'later' if self.later_s >= 0 else 'earlier'}"


class Start(_Change):
    """The ego begins at another speed, or beside its recorded place; the recorded past leads there smoothly.

    Attributes:
        agent: id of the ego.
        faster: change of its speed at the end of the history; slower if negative [m/s].
        left: distance to the left of its recorded place; to the right if negative [m].
    """

    kind: Literal["start"]
    agent: int
    faster: Annotated[_Finite, Field(ge=-20.0, le=20.0)] = 0.0
    left: Annotated[_Finite, Field(ge=-5.0, le=5.0)] = 0.0

    @property
    def text(self) -> str:
        """The change as a sentence."""
        speed = f"{abs(self.faster):.2f} m/s {'faster' if self.faster > 0 else 'slower'}" if self.faster else ""
        side = f"{abs(self.left):.2f} m further {'left' if self.left > 0 else 'right'}" if self.left else ""
        return f"the ego starts {', '.join(filter(None, (speed, side))) or 'as recorded'}"


class SignalsLater(_Change):
    """All signals change at another time.

    Attributes:
        later_s: how much later; earlier if negative [s].
    """

    kind: Literal["signals"]
    later_s: Annotated[_Finite, Field(ge=-600.0, le=600.0)]

    @property
    def text(self) -> str:
        """The change as a sentence."""
        return f"signals change {abs(self.later_s):.1f} s {'later' if self.later_s >= 0 else 'earlier'}"


class Delay(_Change):
    """The ego's commands take effect later, as with more latency anywhere between its sensors and its actuators.

    Attributes:
        later_s: how much, whole steps [s].
    """

    kind: Literal["delay"]
    sentence = "the ego's commands take effect {later_s:.1f} s later"
    later_s: Annotated[_Finite, Field(ge=0.0, le=10.0, multiple_of=STEP_S)]


class Noise(_Change):
    """The ego is told of other agents with errors of position, of which a new one is drawn in each step.

    Attributes:
        sigma_m: their standard deviation, along and across the map's axes [m].
    """

    kind: Literal["noise"]
    sentence = "the ego is told positions with errors of {sigma_m:.2f} m"
    sigma_m: Annotated[_Finite, Field(ge=0.0, le=20.0)]


Act = Brake | CutIn | CutOut | Pace | Cross | Enter | Inattentive
"""Changes by which an agent is an actor."""
OfAgent = Act | Hide | Start
OfAll = SignalsLater | Delay | Noise
Change = Annotated[OfAgent | OfAll, Field(discriminator="kind")]


def changes_of(values: Sequence[Mapping[str, Any]]) -> list[Change]:
    """Returns the changes in the field `changes` of a scenario; raises pydantic.ValidationError for others."""
    return TypeAdapter(list[Change]).validate_python(values)


def changed_recording(
    recording: Recording, changes: Sequence[Change], start_frame: int, history_steps: int
) -> Recording:
    """Returns a recording in which the ego starts, and agents enter, as `changes` say; the same without any."""
    columns = dict(recording.columns)
    columns["frame"] = shifted_frames(recording, changes)
    for change in changes:
        if isinstance(change, Start):
            mine = (columns["vehicle_id"] == change.agent).nonzero()[0]
            step = columns["frame"][mine] - start_frame
            columns |= _started(columns, mine, step, history_steps, change)
    if all(columns[name] is recording.columns[name] for name in columns):
        return recording
    order = np.lexsort((columns["vehicle_id"], columns["frame"]))
    return Recording(recording.header, {name: values[order] for name, values in columns.items()})


def shifted_frames(recording: Recording, changes: Iterable[Change]) -> IntArray:
    """Returns the frames (n,) of the rows of a recording once agents enter when `changes` say."""
    frames, ids = recording.columns["frame"], recording.columns["vehicle_id"]
    for change in changes:
        if isinstance(change, Enter):
            frames = np.where(ids == change.agent, frames + round(change.later_s / STEP_S), frames)
    return frames


def _started(
    columns: dict[str, np.ndarray], rows: np.ndarray, step: np.ndarray, history_steps: int, change: Start
) -> dict[str, np.ndarray]:
    """Returns the columns of the pose and motion of the ego, whose rows (k,) are of the steps `step` (k,).

    Both changes grow over the history as :func:`.geometry.smooth_step`. The ego is ahead of its log by the integral of
    the change of its speed, which stays from the end of the history on.
    """
    u = np.clip(step / history_steps, 0.0, 1.0)
    grown, ahead = smooth_step(u), u**4 * (2.5 - 3 * u + u**2)  # the latter is the integral
    slope = 30 * u**2 * (1 - u) ** 2 / (history_steps * STEP_S)
    forth, left = change.faster * ahead * history_steps * STEP_S, change.left * grown
    yaw, speed = columns["yaw"][rows], columns["speed"][rows]
    faster = np.where(step <= history_steps, change.faster * grown, 0.0)  # its log itself goes on as it was
    new_speed = np.clip(speed + faster, *BOUNDS["speed"])
    moved = {
        "x": columns["x"][rows] + forth * np.cos(yaw) - left * np.sin(yaw),
        "y": columns["y"][rows] + forth * np.sin(yaw) + left * np.cos(yaw),
        "yaw": yaw + np.arctan2(change.left * slope, np.maximum(new_speed, 1.0)),
        "speed": new_speed,
        "acceleration": np.clip(columns["acceleration"][rows] + change.faster * slope, *BOUNDS["acceleration"]),
    }
    changed = {name: columns[name].copy() for name in moved}
    for name, values in moved.items():
        changed[name][rows] = values
    return changed


def acts(changes: Sequence[Change]) -> tuple[Act, ...]:
    """Returns those of `changes` by which agents are actors."""
    return tuple(change for change in changes if isinstance(change, Act))
