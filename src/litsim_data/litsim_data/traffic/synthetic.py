"""Generated recordings: SUMO's traffic on a packaged net, smoothed to plausible vehicle motion."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, replace

import numpy as np
import pandas as pd

from litsim_data.cleaning.report import overlaps
from litsim_data.traffic.motion import smooth_motion
from litsim_data.traffic.traffic import Observation, Site, observe
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.signals import OF_SUMO
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import lanes_from_left
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.recording import Recording, RecordingHeader

SEGMENT_S = 28.1  # [s] 281 frames: steps 0 to 280
MARGIN_S = 8.0  # [s] observed before and after, so that filters have run in: they are metres long, and some creep
SEGMENTS_PER_RECORDING = 10  # so that 70, 10 and 20 % of one are whole segments
REPAIRS = 10  # most rounds in which contacts are removed from a recording
REMOVED_MAX = 0.03  # largest share of the vehicles that may be left out for that
ATTEMPTS = 5  # most seeds tried for a recording of a set, NEXT_SEED apart
NEXT_SEED = 100
DECIMALS = {"x": 6, "y": 6, "yaw": 5, "speed": 5, "acceleration": 3}
"""Decimals written: coarser positions would give steps longer than the speeds allow, finer ones large files."""


def synthesize(seed: int, seconds: float, site: Site) -> Recording:
    """Generates a recording of `seconds` on `site`, by `seed`; equal arguments give equal recordings.

    Raises:
        InputError: `seconds` is too short, or boxes of the smoothed traffic overlap too often (another seed will do).
    """
    return next(_synthesize_all(site, [seed], seconds, attempts=1))


def synthesize_segments(site: Site, segments: int, seed: int) -> Iterator[Recording]:
    """Generates recordings for `segments` segments of 28 s, at most SEGMENTS_PER_RECORDING in each.

    If a seed gives overlaps, others are tried in a fixed order; the header of a recording names the one that was used.

    Raises:
        InputError: as :func:`synthesize`.
    """
    if segments < 1:
        raise InputError(f"{segments} segments are asked for, expected at least 1")
    count = -(-segments // SEGMENTS_PER_RECORDING)
    longest = -(-segments // count)
    seeds = [seed + 1000 * number for number in range(count)]  # so that neighbouring seeds share no recording
    return _synthesize_all(site, seeds, longest * SEGMENT_S, attempts=ATTEMPTS)


def _synthesize_all(site: Site, seeds: list[int], seconds: float, attempts: int) -> Iterator[Recording]:
    """Generates one recording for each of `seeds`, on all processors, each with up to `attempts` seeds."""
    if seconds < STEP_S:
        raise InputError(f"a recording of {seconds} s holds no frame, expected at least {STEP_S} s")
    # libsumo holds one simulation per process, and the caller may be using its own.
    workers = min(len(seeds), os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for job in [pool.submit(_attempt, site, seed, seconds, attempts) for seed in seeds]:
            yield job.result()


def _attempt(site: Site, seed: int, seconds: float, attempts: int) -> Recording:
    """Returns the recording of the first of `attempts` seeds that gives one."""
    for attempt in range(attempts - 1):
        with suppress(InputError):
            return _record(site, seed + attempt * NEXT_SEED, seconds)
    return _record(site, seed + (attempts - 1) * NEXT_SEED, seconds)


def _record(site: Site, seed: int, seconds: float) -> Recording:
    """Makes a recording of simulated traffic, with motion smoothed and overlaps repaired."""
    observation = observe(site, seed, seconds + 2 * MARGIN_S)
    centred, removed = set[int](), set[int]()
    tracks = [_track(site, observation, vehicle, seed, seconds) for vehicle in range(len(observation.vehicles))]
    for _ in range(REPAIRS):
        pairs = overlaps(_joined(tracks))
        if not pairs:
            break
        ids = [vehicle for pair in pairs for vehicle in pair]
        for pair in pairs:
            # Mostly they touch because both keep towards each other: have them keep to the middle of their lanes.
            # Where that is not enough (SUMO moves bodies over junction borders and past tails), one must go.
            if removed & set(pair):  # in this round, for another pair
                continue
            if set(pair) <= centred:
                worst = max(pair, key=lambda vehicle: (ids.count(vehicle), vehicle))
                tracks[worst] = pd.DataFrame()
                removed.add(worst)
                continue
            for vehicle in pair:
                centred.add(vehicle)
                tracks[vehicle] = _track(site, observation, vehicle, seed, seconds, centred=True)
    table = _joined(tracks)
    left = overlaps(table)
    if left or len(removed) > max(2.0, REMOVED_MAX * len(tracks)):
        raise InputError(
            f"seed {seed}: the boxes of {len(left)} pairs of vehicles overlap after {len(removed)} vehicles have been "
            f"left out; choose another seed"
        )
    numbers = {old: new for new, old in enumerate(pd.unique(table["vehicle_id"]), start=1)}
    table["vehicle_id"] = table["vehicle_id"].map(numbers)
    table["lane"] = _lane_from_left(site, table)
    traffic = {"drivers": "calibrated", "flow": sum(route.flow for route in site.routes)}
    notes = {"seed": seed, "seconds": seconds, "traffic": traffic, "left_out": len(removed)}
    header = RecordingHeader(
        name=site.name,
        source="generated with SUMO by LitSim data synthesize",
        licence="Apache-2.0",
        net=site.net.name,
        notes=notes,
        signals=_signals(site, observation, seconds),
    )
    return Recording.from_table(header, table, f"synthetic recording of seed {seed}")


def _track(
    site: Site, observation: Observation, vehicle: int, seed: int, seconds: float, *, centred: bool = False
) -> pd.DataFrame:
    """Returns the rows of one vehicle in the window, in the neutral schema without lane."""
    body = observation.vehicles[vehicle]
    driver = site.smoothness.for_driver(np.random.default_rng([seed, vehicle]))
    if centred:
        driver = replace(driver, offset=0.0, wander=0.0)
    motion = smooth_motion(observation.front[vehicle], observation.speed[vehicle], body.length, driver)
    if motion is None:
        return pd.DataFrame()
    step = observation.first[vehicle] - round(MARGIN_S / STEP_S) + np.arange(len(motion.x))
    rows = pd.DataFrame({"vehicle_id": vehicle, "frame": step, **asdict(motion)})
    rows = rows.assign(length=body.length, width=body.width, kind=int(body.kind))
    x_min, y_min, x_max, y_max = site.window
    inside = (step >= 0) & (step < round(seconds / STEP_S))
    inside &= rows["x"].between(x_min, x_max) & rows["y"].between(y_min, y_max)
    return rows[inside].round(DECIMALS)


def _joined(tracks: list[pd.DataFrame]) -> pd.DataFrame:
    """Returns all tracks, in the order in which vehicles appear."""
    table = pd.concat([track for track in tracks if len(track)], ignore_index=True)
    return table.sort_values(["frame", "x"], ignore_index=True)


def _signals(site: Site, observation: Observation, seconds: float) -> dict[str, object]:
    """Returns the states of the signals as the header has them; links that always show the same form a group."""
    begin, frames = round(MARGIN_S / STEP_S), round(seconds / STEP_S)
    groups: dict[str, list[str]] = {}
    changes: list[tuple[float, str, str]] = []
    by_course: dict[tuple[str, str], str] = {}
    for link in read_links(site.net):
        shown = observation.lights[link.light][begin : begin + frames]
        course = "".join(states[link.index] for states in shown)
        group = by_course.setdefault((link.light, course), f"{link.light}{sum(g[0] == link.light for g in by_course)}")
        if group not in groups:
            changes += [
                (round(frame * STEP_S, 1), group, OF_SUMO[letter].name.lower())
                for frame, letter in enumerate(course)
                if frame == 0 or letter != course[frame - 1]
            ]
        groups.setdefault(group, []).append(link.name)
    return {"groups": groups, "changes": sorted(changes)} if groups else {}


def _lane_from_left(site: Site, table: pd.DataFrame) -> np.ndarray:
    """Returns the lane (n,) of each row, counted from the left edge of its road, 1 first; -1 inside junctions."""
    lane_map = LaneMap.from_net(site.net)
    nearest = lane_map.nearest(*(table[name].to_numpy() for name in ("x", "y", "yaw")))
    numbers = [
        -1 if lane.is_internal else site.lane_of_edge.get(lane.edge_id, from_left)
        for lane, from_left in zip(lane_map.lanes, lanes_from_left(lane_map.lanes), strict=True)
    ]
    return np.array(numbers)[nearest.lane]
