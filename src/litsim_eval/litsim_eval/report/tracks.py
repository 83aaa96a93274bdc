"""Agents over the whole run as dense arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.colours import MODES_OFF_LOG, Mode
from litsim_sim.core.scene import AgentTable, BoolArray, ByteArray, Controller, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.record.run import Run

MOTION = ("x", "y", "yaw", "speed", "acceleration")


@dataclass(frozen=True)
class Tracks:
    """Agents (n,), ids ascending, and their motion (n, frames); a frame is a step since `first`.

    Where an agent is absent, its motion repeats the nearest known value, so that differences stay small.

    Attributes:
        first: step of frame 0.
        id, kind: (n,) ids and kinds of the agents.
        length, width: (n,) [m].
        mode: (n, frames) :class:`litsim_sim.core.colours.Mode`.
        x, y: (n, frames) in frame map [m].
        yaw: (n, frames) unwrapped [rad].
        speed: (n, frames) [m/s].
        acceleration: (n, frames) [m/s2].
    """

    first: int
    id: IntArray
    kind: ByteArray
    length: FloatArray
    width: FloatArray
    mode: ByteArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray

    @property
    def frames(self) -> int:
        """Number of steps from the first to the last one, both included."""
        return int(self.mode.shape[1])

    @property
    def present(self) -> BoolArray:
        """Whether each agent is on the road at each step (n, frames)."""
        return np.asarray(self.mode != Mode.ABSENT)

    def row(self, agent: int) -> int:
        """Returns the row of `agent`; -1 without it."""
        place = int(np.searchsorted(self.id, agent))
        return place if place < len(self.id) and self.id[place] == agent else -1


def tracks_of(run: Run) -> Tracks:
    """Returns every agent of a run; modes of agents under POLICY are told apart by the takeovers."""
    tracks = collect(run.steps, run.tables[0].step, run.tables[-1].step)
    for step, records in run.takeovers.items():
        frame = step - tracks.first
        for record in records if 0 <= frame < tracks.frames else ():
            row = tracks.row(record.agent)
            if row >= 0 and tracks.mode[row, frame] == Mode.POLICY:
                tracks.mode[row, frame] = MODES_OFF_LOG[record.state]
    return tracks


def ghosts_of(run: Run) -> Tracks:
    """Returns logged motion of the agents that ever leave their logs, the ego among them."""
    off_log = [part.stacked.id[part.stacked.off_log] for part in run.steps.parts()]
    wanted = np.unique(np.concatenate(off_log))
    return collect(run.logged.only(wanted.tolist()), run.tables[0].step, run.tables[-1].step)


def collect(tables: Sequence[AgentTable], first: int, last: int) -> Tracks:
    """Returns tables of steps `first` .. `last` as tracks; states that are not finite count as absent."""
    steps = Steps.of(tables)
    table, n, frames = steps.stacked, len(steps.ids), last - first + 1
    usable = np.logical_and.reduce([np.isfinite(getattr(table, name)) for name in (*MOTION, "length", "width")])
    agent, frame = steps.agent[usable], (steps.step - first)[table.number[usable]]
    named = np.isin(table.controller, [c.value for c in Controller])
    mode = np.full((n, frames), Mode.ABSENT, np.uint8)
    mode[agent, frame] = np.where(named, table.controller, Mode.LOG)[usable]
    kind, length, width = np.zeros(n, np.uint8), np.zeros(n), np.zeros(n)
    for of_agent, name in ((kind, "kind"), (length, "length"), (width, "width")):
        of_agent[agent] = getattr(table, name)[usable]  # the last step decides
    motion = {name: np.zeros((n, frames)) for name in MOTION}
    for name, values in motion.items():
        values[agent, frame] = getattr(table, name)[usable]
    _fill(motion, mode != Mode.ABSENT)
    return Tracks(first, steps.ids, kind, length, width, mode, **motion)


def _fill(motion: dict[str, FloatArray], present: BoolArray) -> None:
    """Repeats the last known value where an agent is absent, and before its first the first one."""
    frames = present.shape[1]
    last = np.maximum.accumulate(np.where(present, np.arange(frames), -1), axis=1)
    source = np.where(last >= 0, last, np.argmax(present, axis=1)[:, None])
    for name, values in motion.items():
        values[:] = np.take_along_axis(values, source, axis=1)
        if name == "yaw":
            values[:] = np.unwrap(values, axis=1)
