"""Leaders that brake or come to a stand, in recorded car following."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from litsim_data.encounters.following import FollowingTrack
from litsim_data.encounters.lack import Lack
from litsim_data.encounters.smoothing import centred_place, centred_speed
from litsim_sim.core.scene import STEP_S
from litsim_sim.scenario.encounter_note import EncounterKind

LOST = 2.0  # [m/s] that the leader loses
WITHIN = 30  # steps within which it does
FASTER_THAN = 4.0  # [m/s] before; a slower one counts only if it comes to a stand
MOVES, STANDS = 2.0, 0.3  # [m/s] speeds above and below which a leader moves and stands
STANDS_FOR = 10  # steps for which it then stands
BEGUN = 0.3  # [m/s] that it has lost at the onset
PEAK_WITHIN = 15  # steps in which it is fastest before
HISTORIES = (100, 50, 30)  # steps of history, of which an encounter has the most that are recorded
AFTER = 60  # steps after the onset
GAP_MIN = 1.0  # [m] at the onset
HEADWAY_MAX = 3.5  # [s] at the onset; leaders farther away do not matter
JUMP = 0.5  # [m] of a recorded place from the smooth motion: an error of the record
ROOM = 0.3  # [m] that is left between the vehicles, in the record as in the log


@dataclass(frozen=True)
class Braking:
    """A leader that brakes, or comes to a stand.

    Attributes:
        track: the vehicle behind it.
        onset: sample of the track at which it has begun.
        kind: which of the two.
        lack: why it makes no encounter; None if it does.
    """

    track: FollowingTrack
    onset: int
    kind: EncounterKind = "leader_brakes"
    lack: Lack | None = None

    @property
    def frame(self) -> int:
        """The frame of the onset."""
        return self.track.first_frame + self.onset

    @property
    def name(self) -> str:
        """A name that no other encounter has."""
        return f"{self.track.site}_{self.track.period}_{self.track.follower}_{self.frame}"

    @property
    def history(self) -> int:
        """Number of steps of history."""
        return next(steps for steps in HISTORIES if steps <= self.onset)


def brakings(track: FollowingTrack) -> Iterator[Braking]:
    """Yields the times at which the leader of `track` brakes or comes to a stand, which do not overlap.

    It brakes if it loses 2 m/s within 3 s from at least 4 m/s; a slower one, from 2 m/s on, comes to a stand if it then
    stands for 1 s. Both are searched for in the true motion. The onset is the last step at which the leader has lost
    less than 0.3 m/s, or an earlier one after its peak if the log has more room from there.
    """
    if len(track) <= HISTORIES[-1] + WITHIN + STANDS_FOR:
        return
    speed = centred_speed(track.leader_rear)
    before, after = speed[:-WITHIN], speed[WITHIN:]
    brakes = (before >= FASTER_THAN) & (before - after >= LOST)
    still = np.convolve(after >= STANDS, np.ones(STANDS_FOR), "full")[STANDS_FOR - 1 :] == 0.0
    begins = brakes | ((before >= MOVES) & (before < FASTER_THAN) & still)
    step = HISTORIES[-1]
    while begins[step:].any():
        step += int(np.argmax(begins[step:]))
        peak = step + int(np.argmax(speed[step : step + PEAK_WITHIN]))
        begun = peak + int(np.argmax(speed[peak:] < speed[peak] - BEGUN)) - 1
        roomy = [onset for onset in range(begun, peak - 1, -1) if _log_room(track, onset) > ROOM]
        onset = roomy[0] if roomy else begun
        kind: EncounterKind = "leader_brakes" if brakes[step] else "standing"
        yield Braking(track, onset, kind, _lack(track, onset, log_is_clear=bool(roomy)))
        step = onset + AFTER


def _log_room(track: FollowingTrack, onset: int) -> float:
    """Returns the least gap [m] if both vehicles keep their pace from sample `onset` on."""
    closing = track.speed[onset] - track.leader_speed[onset]
    return float(track.gap[onset] - max(closing, 0.0) * AFTER * STEP_S)


def _lack(track: FollowingTrack, onset: int, *, log_is_clear: bool) -> Lack | None:
    """Returns why the leader that brakes at sample `onset` makes no encounter."""
    if onset + AFTER >= len(track):
        return Lack.SHORT
    if not GAP_MIN <= track.gap[onset] <= HEADWAY_MAX * max(track.speed[onset], 1.0):
        return Lack.FAR
    front, rear = centred_place(track.front), centred_place(track.leader_rear)
    jumps = np.maximum(np.abs(front - track.front), np.abs(rear - track.leader_rear))
    if jumps[max(onset - HISTORIES[0], 0) : onset + AFTER + 1].max() > JUMP:
        return Lack.JUMP
    if (rear - front)[onset : onset + AFTER + 1].min() < ROOM:
        return Lack.RECORD
    return None if log_is_clear else Lack.LOG
