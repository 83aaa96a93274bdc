"""Signals that a whole recording carries: whether its vehicles heed them."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core.scene import RATE_HZ
from litsim_sim.recordings.recording import Recording
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.signals import SignalsFile, build, heed

PIECE = round(60 * RATE_HZ)  # frames of the recording that are looked at together, so that memory does not grow with it


def survey(signals: SignalsFile, net: Path, recording: Recording, where: str) -> list[str]:
    """A line for each group of `signals`, resolved: how many vehicles pass its stop lines, and how many at red.

    Raises:
        InputError: the signals do not fit the net, or are not what the vehicles heed; `where` names them.
    """
    frames = recording.columns["frame"]
    counts: dict[str, tuple[int, int]] = {}
    for start in range(int(frames.min()), int(frames.max()) + 1, PIECE):
        log = Log.from_recording(recording, start, PIECE + 1)
        for group, (passed, at_red) in heed(build(signals, net, log, start, where), log).items():
            before = counts.get(group, (0, 0))
            counts[group] = before[0] + passed, before[1] + at_red
    return [f"signals    {group}: {passed} vehicles pass, {red} at red" for group, (passed, red) in counts.items()]
