"""Random variations of scenes in training."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from pydantic import model_validator

from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference.contract import HISTORY, HISTORY_CHANNELS
from litsim_predictor.inference.lane_frames import LaneFrames, unbend
from litsim_predictor.inference.raster import MapRaster
from litsim_predictor.inference.traffic import Traffic
from litsim_research.predictors.data.scene import Scene, cut_scene
from litsim_research.predictors.data.tracks import Tracks
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.quantities import Angle, Length, NonNegative, Number, Positive, Share, Speed, configuration
from litsim_sim.core.scene import BoolArray, IntArray

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
class Variation:
    """What is drawn at random for one scene of n agents.

    Attributes:
        has_map: whether it has its map.
        stretch: factor by which it is scaled along the road; None if it is not.
        first: (n,) first step of each history that is observed.
        noise: (n, HISTORY, HISTORY_CHANNELS) of the history, in the channels' units.
        region: row of the agent around which the scene is cut, and the distance [m] up to which others are kept; None
            if it is not cut.
        mirrored: whether left and right are exchanged.
    """

    has_map: bool
    stretch: float | None
    first: IntArray
    noise: Float32Array
    region: tuple[int, float] | None
    mirrored: bool

    @classmethod
    def drawn(cls, augmentation: Augmentation, target: BoolArray, random: np.random.Generator) -> Self:
        """Draws the variation of a scene of the agents `target` (n,), of which True are targets."""
        has_map, n = random.random() >= augmentation.no_map, len(target)
        stretch = None
        if augmentation.stretch and random.random() < augmentation.stretch:
            stretch = float(np.exp(random.uniform(*np.log(augmentation.stretch_by))))
        first = np.where(random.random(n) < augmentation.occlude, random.integers(0, HISTORY, n), 0)
        deviation = [augmentation.position_m, augmentation.position_m, augmentation.yaw_rad, augmentation.speed_mps]
        noise = np.array(deviation) * random.standard_normal((n, HISTORY, HISTORY_CHANNELS))
        region = None
        if target.any() and random.random() < augmentation.crop:
            region = int(random.choice(np.flatnonzero(target))), random.uniform(*augmentation.crop_m)
        mirrored = random.random() < augmentation.mirror
        return cls(has_map, stretch, first, noise.astype(np.float32), region, mirrored)


def varied_scene(tracks: Tracks, frame: int, variation: Variation) -> Scene:
    """Returns the scene of `tracks` in `frame` with a `variation`."""
    rows = tracks.rows_at(frame)
    scene = _along_lanes(cut_scene(tracks, rows, None if variation.has_map else NO_MAP), tracks.lane_frames(rows))
    if variation.stretch is not None:
        scene = _stretched(scene, variation.stretch)
    inputs = scene.inputs
    observed = inputs.observed & (np.arange(HISTORY) >= variation.first[:, None])
    history = inputs.history + variation.noise
    history[:, -1, :2] = 0.0  # the origin of the agent frame is the observed position
    history = np.where(observed[..., None], history, np.float32(0.0))
    state = inputs.state.copy()
    state[:, 2], state[:, 3] = np.maximum(history[:, -1, 3], 0.0), history[:, -1, 2]
    history[:, -1, 3] = state[:, 2]
    traffic = Traffic.of_agents(inputs.frame, history, observed).ahead_of(inputs.frame, state[:, 2])
    noisy = replace(inputs, history=history, observed=observed, state=state, traffic=traffic)
    scene = replace(scene, inputs=noisy)
    if variation.region is not None:
        scene = scene.around(*variation.region)
    return _mirrored(scene) if variation.mirrored else scene


def _along_lanes(scene: Scene, lane_frames: LaneFrames) -> Scene:
    """Returns the scene with futures along lanes that bend, as forecasts are meant; see :mod:`.lane_frames`."""
    if not len(lane_frames):
        return scene
    future = scene.future.copy()
    future[lane_frames.row] = unbend(lane_frames.pose, future[lane_frames.row])
    return replace(scene, future=np.where(scene.future_known[..., None], future, 0.0))


def _stretched(scene: Scene, factor: float) -> Scene:
    """Returns the scene with lengths along the road multiplied by `factor`, but not those of vehicles and the map.

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
    """Returns `yaw` [rad] and `speed` [m/s] of any shape, with the component along the road multiplied by `factor`."""
    along, across = factor * np.cos(yaw), np.sin(yaw)
    return np.arctan2(across, along), speed * np.hypot(along, across)


def _mirrored(scene: Scene) -> Scene:
    """Returns the scene with left and right exchanged."""
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
