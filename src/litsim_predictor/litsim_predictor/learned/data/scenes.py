"""Batches of scenes that are cut from tracks, unchanged or with random variations for training."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
from pydantic import model_validator

from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference.contract import HISTORY, HORIZON, AgentInputs
from litsim_predictor.inference.features import agent_inputs
from litsim_predictor.inference.joint_units import TRAFFIC_CHANNELS
from litsim_predictor.inference.raster import CHANNELS, COLUMNS, ROWS, MapRaster
from litsim_predictor.inference.traffic import Traffic
from litsim_predictor.inference.ways import NO_WAYS, Ways
from litsim_predictor.learned.data.batch import SceneBatch, maneuvers_of
from litsim_predictor.learned.data.tracks import Tracks
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.quantities import Angle, Length, NonNegative, Number, Positive, Share, Speed, configuration
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray

NO_MAP = MapRaster(None)
SINE_CHANNEL = 3
SAME_ROAD = 0.35  # [rad] largest difference of headings from their mean where all agents drive along the same road


@configuration
class Augmentation:
    """Random variations of scenes in training.

    Attributes:
        mirror: probability that left and right of a scene are exchanged.
        occlude: probability that the history of an agent is cut to a random number of last steps, at least one.
        no_map: probability that a scene has no map.
        crop: probability that a scene is reduced to the agents within a random distance of a target, as in a region of
            interest; features of the traffic ahead remain those of the whole scene.
        crop_m: least and greatest such distance.
        stretch: probability that a scene is scaled along the road, for traffic at other speeds; see :func:`_stretched`.
        stretch_by: least and greatest factor; the distribution is log-uniform.
        position_m, yaw_rad, speed_mps: standard deviations of noise on the history.
    """

    mirror: Share = 0.5
    occlude: Share = 0.3
    no_map: Share = 0.1
    crop: Share = 0.5
    crop_m: tuple[NonNegative[Length], NonNegative[Length]] = (20.0, 80.0)
    stretch: Share = 0.0
    stretch_by: tuple[Positive[Number], Positive[Number]] = (0.8, 1.5)
    position_m: NonNegative[Length] = 0.03
    yaw_rad: NonNegative[Angle] = 0.005
    speed_mps: NonNegative[Speed] = 0.1

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        for name, (least, most) in (("crop_m", self.crop_m), ("stretch_by", self.stretch_by)):
            if least > most:
                raise ValueError(f"{name} is {[least, most]}, expected the least value first")
        return self


@dataclass(frozen=True)
class _Scene:
    inputs: AgentInputs
    future: FloatArray
    future_known: BoolArray
    target: BoolArray
    ways: Ways = NO_WAYS

    def around(self, agent: int, metres: float) -> _Scene:
        """The scene reduced to the agents within `metres` [m] of the agent in row `agent`."""
        place = self.inputs.frame[:, :2]
        near = np.hypot(*(place - place[agent]).T) <= metres
        bends = near[self.ways.row]
        ways = Ways((near.cumsum() - 1)[self.ways.row[bends]], self.ways.pose[bends])
        return _Scene(self.inputs.take(near), self.future[near], self.future_known[near], self.target[near], ways)


def scene_batches(
    sources: Sequence[Tracks],
    agents_per_batch: int = 512,
    stride: int = 2,
    *,
    complete: bool = True,
    roi_m: float = 0.0,
) -> Iterator[SceneBatch]:
    """Scenes of `sources` in temporal order, without variations.

    Args:
        sources: tracks from which scenes are cut.
        agents_per_batch: approximate number of agents in a batch; a batch contains at least one scene.
        stride: frames between scenes.
        complete: whether targets need 3 s of history and 5 s of future without gaps, as in the published protocol;
            otherwise one known step of the future suffices.
        roi_m: if above 0, every target has a scene of its own, with the agents within this distance [m].
    """
    for tracks in sources:
        moments = [(tracks, int(frame)) for frame in tracks.frames[::stride]]
        yield from _batches(moments, agents_per_batch, complete=complete, roi_m=roi_m)


def training_batches(
    sources: Sequence[tuple[Tracks, float]],
    agents_per_batch: int,
    stride: int,
    augmentation: Augmentation,
    random: np.random.Generator,
) -> Iterator[SceneBatch]:
    """Scenes of one epoch, shuffled and randomly varied.

    Args:
        sources: tracks, each with the share of its scenes that an epoch contains; if that is above 1, scenes occur
            several times. Scenes are cut at frames with a target.
        agents_per_batch: approximate number of agents in a batch.
        stride: number of frames with a target from one scene of a source to the next; the first is drawn at random.
        augmentation: variations of the scenes.
        random: generator of all draws.
    """
    moments = []
    for tracks, share in sources:
        frames = tracks.target_frames[int(random.integers(stride)) :: stride]
        times = np.floor(share + random.random(len(frames))).astype(np.int64)
        moments += [(tracks, int(frame)) for frame in np.repeat(frames, times)]
    # Scenes of similar size share a batch, so that there is little padding; the batches are then shuffled.
    sizes = np.array([len(tracks.rows_at(frame)) for tracks, frame in moments])
    order = np.argsort(sizes + random.uniform(0.0, 4.0, len(sizes)), kind="stable")
    batches = list(_grouped([moments[k] for k in order], sizes[order], agents_per_batch))
    for k in random.permutation(len(batches)):
        scenes = [_varied(tracks, frame, augmentation, random) for tracks, frame in batches[k]]
        scenes = [scene for scene in scenes if scene.target.any()]
        if scenes:
            yield _stack(scenes)


def _batches(moments: list[tuple[Tracks, int]], agents: int, *, complete: bool, roi_m: float) -> Iterator[SceneBatch]:
    scenes: list[_Scene] = []
    for tracks, frame in moments:
        rows = tracks.rows_at(frame)
        scene = _scene(tracks, rows)
        if complete:
            scene = replace(
                scene, target=scene.target & scene.inputs.observed.all(axis=1) & scene.future_known.all(axis=1)
            )
        if not scene.target.any():
            continue
        scene = replace(scene, ways=tracks.ways(rows))
        scenes += _around_each(scene, roi_m) if roi_m else [scene]
        if sum(len(scene.target) for scene in scenes) >= agents:
            yield _stack(scenes)
            scenes = []
    if scenes:
        yield _stack(scenes)


def _grouped(moments: list[tuple[Tracks, int]], sizes: IntArray, agents: int) -> Iterator[list[tuple[Tracks, int]]]:
    group: list[tuple[Tracks, int]] = []
    for moment, size in zip(moments, sizes, strict=True):
        if group and (len(group) + 1) * size > agents:
            yield group
            group = []
        group.append(moment)
    if group:
        yield group


def _scene(tracks: Tracks, rows: IntArray, raster: MapRaster | None = None) -> _Scene:
    """The scene of the vehicles in `rows`, all of one frame; `raster`, if given, replaces the map of `tracks`."""
    past, observed = tracks.history(rows)
    later, known = tracks.future(rows)
    inputs = agent_inputs(
        tracks.motion[past], observed, tracks.size[rows], tracks.heading[rows], raster or tracks.raster
    )
    x, y, heading = inputs.frame.T[..., None]
    future = np.stack(to_body(tracks.motion[later, 0] - x, tracks.motion[later, 1] - y, heading), axis=-1)
    return _Scene(
        inputs=inputs,
        future=np.where(known[..., None], future, 0.0),
        future_known=known,
        target=tracks.target[rows] & known.any(axis=1),
    )


def _around_each(scene: _Scene, roi_m: float) -> list[_Scene]:
    """A scene for each target of `scene`, reduced to the agents within `roi_m` [m] of it."""
    alone = np.eye(len(scene.target), dtype=np.bool_)
    return [replace(scene, target=alone[row]).around(int(row), roi_m) for row in np.flatnonzero(scene.target)]


def _varied(tracks: Tracks, frame: int, augmentation: Augmentation, random: np.random.Generator) -> _Scene:
    scene = _scene(tracks, tracks.rows_at(frame), NO_MAP if random.random() < augmentation.no_map else None)
    if augmentation.stretch and random.random() < augmentation.stretch:
        scene = _stretched(scene, float(np.exp(random.uniform(*np.log(augmentation.stretch_by)))))
    inputs, n = scene.inputs, len(scene.target)
    first = np.where(random.random(n) < augmentation.occlude, random.integers(0, HISTORY, n), 0)
    observed = inputs.observed & (np.arange(HISTORY) >= first[:, None])
    deviation = np.array(
        [augmentation.position_m, augmentation.position_m, augmentation.yaw_rad, augmentation.speed_mps]
    )
    history = inputs.history + (deviation * random.standard_normal(inputs.history.shape)).astype(np.float32)
    history[:, -1, :2] = 0.0  # the origin of the agent frame is the observed position
    history = np.where(observed[..., None], history, np.float32(0.0))
    state = inputs.state.copy()
    state[:, 2], state[:, 3] = np.maximum(history[:, -1, 3], 0.0), history[:, -1, 2]
    history[:, -1, 3] = state[:, 2]
    traffic = Traffic.of_agents(inputs.frame, history, observed).ahead_of(inputs.frame, state[:, 2])
    seen = replace(inputs, history=history, observed=observed, state=state, traffic=traffic)
    scene = replace(scene, inputs=seen)
    if scene.target.any() and random.random() < augmentation.crop:
        scene = scene.around(int(random.choice(np.flatnonzero(scene.target))), random.uniform(*augmentation.crop_m))
    return _mirrored(scene) if random.random() < augmentation.mirror else scene


def _stretched(scene: _Scene, factor: float) -> _Scene:
    """The scene with all lengths along the road multiplied by `factor`, except those of vehicles and of the map.

    Speeds, accelerations and distances between centres along the road are scaled as well; time headways and lateral
    speeds do not change. A scene whose vehicles drive in different directions is returned unchanged, since it has no
    common road direction.
    """
    inputs = scene.inputs
    heading = inputs.frame[:, 2]
    common = np.arctan2(np.sin(heading).sum(keepdims=True), np.cos(heading).sum(keepdims=True))
    if np.abs(wrap_angle(heading - common)).max() > SAME_ROAD:
        return scene
    ahead, left = to_body(inputs.frame[:, 0], inputs.frame[:, 1], common)
    x, y = to_body(factor * ahead, left, -common)
    history, state = inputs.history.copy(), inputs.state.copy()
    history[..., 0] *= factor
    history[..., 2], history[..., 3] = _stretched_motion(history[..., 2], history[..., 3], factor)
    state[:, 3], state[:, 2] = _stretched_motion(state[:, 3], state[:, 2], factor)
    stretched = replace(inputs, frame=np.stack([x, y, heading], axis=-1), history=history, state=state)
    return replace(scene, inputs=stretched, future=scene.future * [factor, 1.0])


def _stretched_motion(yaw: Float32Array, speed: Float32Array, factor: float) -> tuple[Float32Array, Float32Array]:
    """`yaw` [rad] and `speed` [m/s] of any shape, with the component along the road multiplied by `factor`."""
    along, across = factor * np.cos(yaw), np.sin(yaw)
    return np.arctan2(across, along), speed * np.hypot(along, across)


def _mirrored(scene: _Scene) -> _Scene:
    """The scene with left and right exchanged."""
    inputs = scene.inputs
    raster = inputs.raster[..., ::-1].copy()
    # The sine changes its sign about byte 128; byte 0 does not occur.
    raster[:, SINE_CHANNEL] = np.uint8(0) - raster[:, SINE_CHANNEL]
    mirrored = replace(
        inputs,
        frame=inputs.frame * [1.0, -1.0, -1.0],
        history=inputs.history * np.array([1.0, -1.0, -1.0, 1.0], np.float32),
        state=inputs.state * np.array([1.0, 1.0, 1.0, -1.0], np.float32),
        raster=raster,
    )
    return replace(scene, inputs=mirrored, future=scene.future * [1.0, -1.0])


def _stack(scenes: Sequence[_Scene]) -> SceneBatch:
    batch = inputs_batch([scene.inputs for scene in scenes], [scene.ways for scene in scenes])
    future = np.zeros((*batch.agent.shape, HORIZON, 2), np.float32)
    known = np.zeros((*batch.agent.shape, HORIZON), np.bool_)
    target = np.zeros(tuple(batch.agent.shape), np.bool_)
    for k, scene in enumerate(scenes):
        n = len(scene.target)
        future[k, :n], known[k, :n], target[k, :n] = scene.future, scene.future_known, scene.target
    truth = torch.from_numpy(future)
    return replace(
        batch,
        future=truth,
        future_known=torch.from_numpy(known),
        maneuver=maneuvers_of(truth, torch.from_numpy(known), batch.state[..., 2]),
        target=torch.from_numpy(target),
    )


def inputs_batch(scenes: Sequence[AgentInputs], ways: Sequence[Ways] = ()) -> SceneBatch:
    """A batch of `scenes`, with the `ways` of each (none if empty), whose futures are unknown as in a run."""
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
        ways=Ways.of_scenes(ways, size[1]) if ways else NO_WAYS,
    )
