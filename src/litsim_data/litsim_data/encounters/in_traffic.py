"""Encounters in recorded traffic on a net, among all vehicles that were recorded."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.lack import Lack
from litsim_data.encounters.leader_brakes import AFTER, HISTORIES
from litsim_data.encounters.moments import FOLLOWED, Moment, moments
from litsim_data.encounters.origin import Origin
from litsim_data.encounters.pace import at_pace, recorded
from litsim_data.encounters.reaction import reaction
from litsim_data.encounters.split import split_of
from litsim_data.mining.events import Situation
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import boxes_overlap
from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.encounter_note import KINDS, EncounterKind, EncounterNote, Track, TrackNote, Truth
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recorded_net import net_of
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario, packaged_scenarios

BLOCK = 600  # steps that are searched at once, to bound memory
SHORTEST = 50  # steps after the onset, at the end of a record: reactions are compared up to 5 s
MOVES = 2.0  # [m/s] of a vehicle that has to react
DONE = 2.0  # [m] from its pace of a vehicle that does something
NEAR, SOON = 2.0, 4.0  # [m], [s] gap and time to collision below which a vehicle at its pace has to react


@dataclass(frozen=True)
class Traffic:
    """Recorded traffic in which encounters are searched for.

    Attributes:
        recording: the traffic.
        origin: what it is, and its net.
        site: where it was recorded.
        period: which of the recordings of the site it is.
        left_out: number of moments that make no encounter, by what they lack; grows with the search.
    """

    recording: Recording
    origin: Origin
    site: str
    period: int = 0
    left_out: Counter[Lack] = field(default_factory=Counter)

    @classmethod
    def of(cls, name: str, net: str | None, left_out: Counter[Lack]) -> Traffic:
        """Returns the traffic of a recording or scenario `name`; `net` names another net than its own.

        Raises:
            InputError: it cannot be read, or there is no net.
        """
        path = Path(name)
        if name in packaged_scenarios() or path.suffix in (".yaml", ".yml"):
            if net is not None:
                raise InputError(f"--net: {name} is a scenario, which names its net, expected a recording")
            scenario = Scenario.load(name)
            recording, net_path, lane_map = scenario.recording, scenario.net_path, scenario.lane_map
        else:
            recording = load_recording(path)
            net_path = net_of(recording.header, path, net)
            lane_map = LaneMap.from_net(net_path)
        header = recording.header
        signals = header.signals if header.net == net_path.name else {}
        origin = Origin(header.source, header.licence, net_path, lane_map, signals)
        return cls(recording, origin, re.sub(r"\W", "_", header.name or path.stem), left_out=left_out)

    @property
    def blocks(self) -> list[tuple[int, int]]:
        """First frame and end of the blocks in which onsets are searched for."""
        frames = self.recording.columns["frame"]
        first, last = int(frames.min()), int(frames.max())
        return [(begin, min(begin + BLOCK, last + 1)) for begin in range(first, last + 1, BLOCK)]

    def encounters(self, block: tuple[int, int], kinds: Collection[EncounterKind] = KINDS) -> Iterator[Encounter]:
        """Yields the encounters of `kinds` with onsets in a `block` of frames, in their order.

        Those of one agent do not overlap.
        """
        frames = self.recording.columns["frame"]
        begin = max(block[0] - HISTORIES[0], int(frames.min()))
        end = min(block[1] + AFTER, int(frames.max()) + 1)
        part = self.recording.take((frames >= begin) & (frames < end))
        situation = Situation.of(Log.from_recording(part, begin, end - begin), self.origin.lane_map)
        free_from = dict[int, int]()
        for onset, moment in self._usable(situation, (block[0] - begin, block[1] - begin), kinds):
            if onset >= free_from.get(moment.agent, 0):
                free_from[moment.agent] = onset + AFTER
                yield self._encounter(part, situation, moment, onset)

    def _usable(
        self, situation: Situation, steps: tuple[int, int], kinds: Collection[EncounterKind]
    ) -> list[tuple[int, Moment]]:
        """Returns the moments of `kinds` that make encounters, with their onsets in `steps` (begin, end), in order."""
        usable = []
        for moment in moments(situation):
            onset, lack = _judged(situation, moment)
            if moment.kind in kinds and steps[0] <= onset < steps[1]:
                if lack is None:
                    usable.append((onset, moment))
                else:
                    self.left_out[lack] += 1
        return sorted(
            usable, key=lambda scored: (scored[0], KINDS.index(scored[1].kind), scored[1].agent, scored[1].opponent)
        )

    def _encounter(self, part: Recording, situation: Situation, moment: Moment, onset: int) -> Encounter:
        """Returns the encounter of a `moment` that begins at step `onset` of a `part` of the recording."""
        log, begin = situation.log, int(part.columns["frame"].min())
        ids = [int(log.ids[row]) for row in moment.rows]
        present = onset - int(log.first_step[moment.rows].max())
        first = onset - next(steps for steps in HISTORIES if steps <= present)
        last = _last(log, moment, onset)
        truth = [TrackNote.of(recorded(situation, row, first, last)) for row in moment.rows]
        note = EncounterNote(
            kind=moment.kind,
            site=self.site,
            agent=ids[0],
            opponent=ids[1],
            onset_step=onset - first,
            split=split_of(self.site, self.period, ids[0]),
            truth=Truth(agent=truth[0], opponent=truth[1]),
        )
        rows = (part.columns["frame"] >= begin + first) & (part.columns["frame"] <= begin + last)
        columns = {name: values[rows].copy() for name, values in part.columns.items()}
        for row in moment.rows:
            later = (columns["vehicle_id"] == log.ids[row]) & (columns["frame"] > begin + onset)
            for name, values in vars(at_pace(situation, row, onset, last)).items():
                columns[name][later] = values[1:]
            columns["acceleration"][later] = 0.0
        return self.origin.encounter(f"{self.site}_{self.period}_{ids[0]}_{begin + onset}", note, columns)


def _last(log: Log, moment: Moment, onset: int) -> int:
    """Returns the last step of the encounter that begins at step `onset`."""
    return min(onset + AFTER, int(log.last_step[moment.rows].min()))


def _judged(situation: Situation, moment: Moment) -> tuple[int, Lack | None]:
    """Returns the onset of a `moment`, and what it lacks for an encounter from there on."""
    lacks = [moment.lack or _lack(situation, moment, onset) for onset in moment.onsets]
    best = lacks.index(None) if None in lacks else 0
    return moment.onsets[best], lacks[best]


def _lack(situation: Situation, moment: Moment, onset: int) -> Lack | None:
    """Returns what a `moment` lacks for an encounter from step `onset` on."""
    log, last = situation.log, _last(situation.log, moment, onset)
    if onset - HISTORIES[-1] < log.first_step[moment.rows].max() or last - onset < SHORTEST:
        return Lack.SHORT
    agent, opponent = (recorded(situation, row, onset, last) for row in moment.rows)
    own, other = (at_pace(situation, row, onset, last) for row in moment.rows)
    sizes = [(float(log.length[row]), float(log.width[row])) for row in moment.rows]
    if _touch(agent, opponent, *sizes):
        return Lack.RECORD
    if np.hypot(other.x - opponent.x, other.y - opponent.y).max() < DONE:
        return Lack.IDLE
    unmoved = reaction(moment.kind, own, opponent, 0, *sizes)
    if own.speed[0] < MOVES or not (
        moment.kind in FOLLOWED or unmoved.contact or unmoved.least_gap < NEAR or unmoved.least_ttc < SOON
    ):
        return Lack.EASY
    if _touch(own, other, *sizes):
        return Lack.LOG
    return Lack.OTHERS if _touches_others(log, moment, onset, own) else None


def _touch(a: Track, b: Track, a_size: tuple[float, float], b_size: tuple[float, float]) -> bool:
    """Returns whether boxes of lengths and widths [m] overlap at any step."""
    sizes = [(np.asarray(length), np.asarray(width)) for length, width in (a_size, b_size)]
    return bool(boxes_overlap(b.x - a.x, b.y - a.y, a.yaw, b.yaw, sizes[0], sizes[1]).any())


def _touches_others(log: Log, moment: Moment, onset: int, own: Track) -> bool:
    """Returns whether the agent, on the track `own` from step `onset` on, overlaps any other than the opponent."""
    part = slice(onset, onset + len(own))
    others = np.delete(np.arange(len(log.ids)), moment.rows)

    def of(row: int | np.ndarray) -> tuple[FloatArray, FloatArray]:
        return log.length[row, None], log.width[row, None]

    dx, dy = log.x[others, part] - own.x, log.y[others, part] - own.y
    overlap = boxes_overlap(dx, dy, own.yaw, log.yaw[others, part], of(moment.agent), of(others))
    return bool((overlap & log.valid[others, part]).any())
