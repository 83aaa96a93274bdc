"""Batches of scenes that are cut from tracks, unchanged or with random variations for training."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from litsim_predictor.inference.contract import HISTORY, HORIZON, AgentInputs
from litsim_predictor.inference.joint.units import TRAFFIC_CHANNELS
from litsim_predictor.inference.lane_frames import NO_LANE_FRAMES, LaneFrames
from litsim_predictor.inference.raster import CHANNELS, COLUMNS, ROWS
from litsim_research.predictors.data.augmentation import Augmentation, Variation, varied_scene
from litsim_research.predictors.data.batch import SceneBatch, maneuvers_of
from litsim_research.predictors.data.scene import Scene, cut_scene
from litsim_research.predictors.data.tracks import Tracks
from litsim_sim.core.scene import IntArray
from litsim_sim.launch.signals import SIGNALS, signals_deferred


def scene_batches(
    sources: Sequence[Tracks],
    agents_per_batch: int = 512,
    stride: int = 2,
    roi_m: float = 0.0,
) -> Iterator[SceneBatch]:
    """Yields scenes of `sources` in temporal order, without variations.

    As in the published protocol, targets have 3 s of history and 5 s of future without gaps.

    Args:
        sources: tracks from which scenes are cut.
        agents_per_batch: approximate number of agents in a batch; a batch contains at least one scene.
        stride: frames between scenes.
        roi_m: if above 0, every target has a scene of its own, with the agents within this distance [m].
    """
    for tracks in sources:
        scenes: list[Scene] = []
        for frame in tracks.frames[::stride]:
            rows = tracks.rows_at(int(frame))
            scene = cut_scene(tracks, rows)
            target = scene.target & scene.inputs.observed.all(axis=1) & scene.future_known.all(axis=1)
            if not target.any():
                continue
            scene = replace(scene, target=target, lane_frames=tracks.lane_frames(rows))
            scenes += _around_each(scene, roi_m) if roi_m else [scene]
            if sum(len(scene.target) for scene in scenes) >= agents_per_batch:
                yield _stack(scenes)
                scenes = []
        if scenes:
            yield _stack(scenes)


Plan = list[tuple[int, int, Variation]]
"""Scenes of a batch: numbers of their tracks and of their frames, and how they are varied."""


@dataclass(frozen=True)
class PlannedBatches(Dataset[SceneBatch]):
    """Batches of scenes cut from `sources`, by their plans."""

    sources: Sequence[Tracks]

    def __getitem__(self, plan: Plan) -> SceneBatch:
        """Returns the batch of a plan."""
        return _stack([varied_scene(self.sources[k], frame, variation) for k, frame, variation in plan])


def training_batches(
    sources: Sequence[tuple[Tracks, float]],
    agents_per_batch: int,
    stride: int,
    augmentation: Augmentation,
    random: np.random.Generator,
    workers: int = 0,
) -> Iterator[SceneBatch]:
    """Returns scenes of one epoch, shuffled and randomly varied.

    This process draws what is random, so that the batches do not depend on the number of workers.

    Args:
        sources: tracks, each with the share of its scenes that an epoch contains; if that is above 1, scenes occur
            several times. Scenes are cut at frames with a target.
        agents_per_batch: approximate number of agents in a batch.
        stride: number of frames with a target from one scene of a source to the next; the first is drawn at random.
        augmentation: variations of the scenes.
        random: generator of all draws.
        workers: number of processes that make batches ahead; 0 to make them in this one.
    """
    loader = DataLoader(
        PlannedBatches([tracks for tracks, _ in sources]),
        batch_size=None,
        sampler=_plans(sources, agents_per_batch, stride, augmentation, random),
        num_workers=workers,
        multiprocessing_context="fork" if workers else None,  # the tracks are not copied
        worker_init_fn=_unblock_signals,
        generator=torch.Generator(),  # else its seeds are drawn from the generator of the training
    )
    with signals_deferred() if workers else nullcontext():  # Ctrl-C during a fork would be lost
        return iter(loader)


def _unblock_signals(_: int) -> None:
    """In a worker, which was started while signals were deferred: let the process that trains end it."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def _plans(
    sources: Sequence[tuple[Tracks, float]],
    agents_per_batch: int,
    stride: int,
    augmentation: Augmentation,
    random: np.random.Generator,
) -> Iterator[Plan]:
    """Yields the plans of the batches of one epoch; see :func:`training_batches`."""
    moments = []
    for number, (tracks, share) in enumerate(sources):
        frames = tracks.target_frames[int(random.integers(stride)) :: stride]
        times = np.floor(share + random.random(len(frames))).astype(np.int64)
        moments += [(number, int(frame)) for frame in np.repeat(frames, times)]
    # Scenes of similar size share a batch, so that there is little padding; the batches are then shuffled.
    sizes = np.array([len(sources[number][0].rows_at(frame)) for number, frame in moments])
    order = np.argsort(sizes + random.uniform(0.0, 4.0, len(sizes)), kind="stable")
    batches = list(_grouped([moments[k] for k in order], sizes[order], agents_per_batch))
    for k in random.permutation(len(batches)):
        plan = []
        for number, frame in batches[k]:
            tracks, _ = sources[number]
            target = tracks.learnable[tracks.rows_at(frame)]
            variation = Variation.drawn(augmentation, target, random)
            if target.any():
                plan.append((number, frame, variation))
        if plan:
            yield plan


def _grouped(moments: list[tuple[int, int]], sizes: IntArray, agents: int) -> Iterator[list[tuple[int, int]]]:
    """Yields consecutive `moments` in groups of at most `agents` agents, padding included; `sizes` are ascending."""
    group: list[tuple[int, int]] = []
    for moment, size in zip(moments, sizes, strict=True):
        if group and (len(group) + 1) * size > agents:
            yield group
            group = []
        group.append(moment)
    if group:
        yield group


def _around_each(scene: Scene, roi_m: float) -> list[Scene]:
    """Returns a scene for each target of `scene`, reduced to the agents within `roi_m` [m] of it."""
    alone = np.eye(len(scene.target), dtype=np.bool_)
    return [replace(scene, target=alone[row]).around(int(row), roi_m) for row in np.flatnonzero(scene.target)]


def _stack(scenes: Sequence[Scene]) -> SceneBatch:
    batch = inputs_batch([scene.inputs for scene in scenes], [scene.lane_frames for scene in scenes])
    future = np.zeros((*batch.agent.shape, HORIZON, 2), np.float32)
    recorded = np.zeros((*batch.agent.shape, HORIZON), np.bool_)
    target = np.zeros(tuple(batch.agent.shape), np.bool_)
    for k, scene in enumerate(scenes):
        n = len(scene.target)
        future[k, :n], recorded[k, :n], target[k, :n] = scene.future, scene.future_known, scene.target
    truth = torch.from_numpy(future)
    return replace(
        batch,
        future=truth,
        future_known=torch.from_numpy(recorded),
        maneuver=maneuvers_of(truth, torch.from_numpy(recorded), batch.state[..., 2]),
        target=torch.from_numpy(target),
    )


def inputs_batch(scenes: Sequence[AgentInputs], lane_frames: Sequence[LaneFrames] = ()) -> SceneBatch:
    """Returns a batch of `scenes`, with the `lane_frames` of each (none if empty), and unknown futures as in a run."""
    size = len(scenes), max(len(scene.state) for scene in scenes)
    history = np.zeros((*size, *scenes[0].history.shape[1:]), np.float32)
    observed = np.zeros((*size, HISTORY), np.bool_)
    state = np.zeros((*size, scenes[0].state.shape[1]), np.float32)
    traffic = np.zeros((*size, TRAFFIC_CHANNELS), np.float32)
    raster = np.zeros((*size, CHANNELS, ROWS, COLUMNS), np.uint8)
    frame = np.zeros((*size, 3), np.float64)
    agent = np.zeros(size, np.bool_)
    for k, scene in enumerate(scenes):
        n = len(scene.state)
        history[k, :n], observed[k, :n], state[k, :n] = scene.history, scene.observed, scene.state
        raster[k, :n], agent[k, :n], frame[k, :n] = scene.raster, True, scene.frame
        traffic[k, :n] = scene.traffic
        # Only differences matter, and in single precision they are accurate near the origin only.
        frame[k, :n, :2] -= scene.frame[:1, :2]
    return SceneBatch(
        position=torch.from_numpy(frame[..., :2].astype(np.float32)),
        heading=torch.from_numpy(frame[..., 2].astype(np.float32)),
        history=torch.from_numpy(history),
        observed=torch.from_numpy(observed),
        state=torch.from_numpy(state),
        traffic=torch.from_numpy(traffic),
        raster=torch.from_numpy(raster),
        agent=torch.from_numpy(agent),
        future=torch.zeros(*size, HORIZON, 2),
        future_known=torch.zeros(*size, HORIZON, dtype=torch.bool),
        maneuver=torch.full(size, -1),
        target=torch.zeros(size, dtype=torch.bool),
        lane_frames=LaneFrames.of_scenes(lane_frames, size[1]) if lane_frames else NO_LANE_FRAMES,
    )
