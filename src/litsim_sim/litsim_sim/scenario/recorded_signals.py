"""Check whether the vehicles of a recording heed its signals, and whether groups with conflicts are green together."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core.scene import RATE_HZ
from litsim_sim.lane_map.signal_links import LEAVES, read_links
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.signal_conflicts import green_conflicts
from litsim_sim.scenario.signals import PASSED_MIN, SignalsFile, check_known, check_passages, count_passages, signals_of

DOUBTFUL = 0.1  # share of passages at red above which a line asks whether connections and times are right
PIECE = round(60 * RATE_HZ)  # frames processed at once, to bound memory


def survey(signals: SignalsFile, net: Path, recording: Recording, where: str) -> list[str]:
    """Returns lines with how many vehicles pass the stop lines of each group of `signals`, in total and at red.

    Further lines warn of groups that are green together though they conflict, see :func:`.green_conflicts`.

    Raises:
        InputError: the signals do not fit the net, are not heeded by the vehicles, or are never known; `where` names
            them.
    """
    frames = recording.columns["frame"]
    first, last, shown = int(frames.min()), int(frames.max()), False
    links, counts = read_links(net), dict[str, tuple[int, int]]()
    for start in range(first, last + 1, PIECE):
        log = Log.from_recording(recording, start, PIECE + 1 + LEAVES)  # LEAVES: shows which way the last ones take
        lights = signals_of(signals, links, log.steps, start, where)
        shown |= lights.known
        for group, (passed, at_red) in count_passages(lights, log, PIECE).items():
            before = counts.get(group, (0, 0))
            counts[group] = before[0] + passed, before[1] + at_red
    check_passages(counts, where)
    check_known(signals, shown, (first, last), where)
    lines = [_line(group, passed, at_red) for group, (passed, at_red) in counts.items()]
    everything = signals_of(signals, links, last - first + 1, first, where)
    return lines + [f"signals    WARNING: {sentence}" for sentence in green_conflicts(signals, everything, first)]


def _line(group: str, passed: int, at_red: int) -> str:
    many = passed >= PASSED_MIN and at_red > max(1.0, DOUBTFUL * passed)  # a single one may well do it
    asked = "; so many hardly do, but for right turns: are its connections and times right?" if many else ""
    return f"signals    {group}: {passed} vehicles pass, {at_red} at red{asked}"
