"""Evaluation of predicted conflicts between an ego that deviates from its log and the logged background.

The paper detects conflicts by overlaps of the ego's forecast with the logged background. Here, egos deviate along their
logged paths: they brake, or keep their speed. At each step, a conflict with another agent within 1 to 5 s is predicted
if the ego's forecast overlaps the agent's logged boxes, and real if the ego's further drive does. Both are judged by
oriented boxes at the same instants. Agents within the ROI are counted, each until it first touches the ego.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import islice
from typing import Any

import numpy as np
import torch

from litsim_predictor.inference.contract import AT_SECONDS, HORIZON, SECONDS, STRIDE, AgentInputs
from litsim_predictor.inference.features import agent_inputs, in_map
from litsim_predictor.inference.lane_frames import LaneFrames
from litsim_research.predictors.data.batch import numbers
from litsim_research.predictors.data.scenes import inputs_batch
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.evaluation.boxes import path_headings
from litsim_research.predictors.evaluation.drives import DRIVE_KINDS, Drive, DriveKind, drives
from litsim_research.predictors.models.model import SceneModel
from litsim_sim.core.geometry import boxes_overlap
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.scenario import Scenario

SCENES_PER_BATCH = 64


@dataclass(frozen=True)
class ConflictCounts:
    """Numbers of pairs of a step and an agent, (5,) by horizon of 1 to 5 s.

    Attributes:
        hit: pairs with a conflict that is predicted and real.
        false: pairs with a conflict that is predicted only.
        missed: pairs with a conflict that is real only.
        pairs: all pairs, with and without conflicts.
    """

    hit: IntArray
    false: IntArray
    missed: IntArray
    pairs: IntArray

    @classmethod
    def of(cls, predicted: BoolArray, real: BoolArray, valid: BoolArray) -> ConflictCounts:
        """Returns the counts of n pairs; masks (n, 5), by horizon: predicted conflicts, real ones, counted pairs."""
        masks = predicted & real & valid, predicted & ~real & valid, ~predicted & real & valid, valid
        return cls(*(mask.sum(axis=0) for mask in masks))

    def __add__(self, other: ConflictCounts) -> ConflictCounts:
        return ConflictCounts(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def to_json(self) -> dict[str, Any]:
        """Returns precision and recall by horizon, and the counts; None without predicted or real conflicts."""
        return {
            str(second): {
                "precision": _share(self.hit[k], self.hit[k] + self.false[k]),
                "recall": _share(self.hit[k], self.hit[k] + self.missed[k]),
                "predicted": int(self.hit[k] + self.false[k]),
                "real": int(self.hit[k] + self.missed[k]),
                "pairs": int(self.pairs[k]),
            }
            for k, second in enumerate(SECONDS)
        }


NO_COUNTS = ConflictCounts(*np.zeros((4, len(SECONDS)), np.int64))


def conflict_counts(
    models: Mapping[str, SceneModel],
    scenario: Scenario,
    egos: Sequence[int],
    seed: int,
    done: Callable[[], object],
    *,
    signals: bool = False,
) -> dict[str, dict[DriveKind, ConflictCounts]]:
    """Counts predicted and real conflicts when `egos` of `scenario` deviate from their logs.

    Each of the `egos` makes 1 + :data:`.drives.BRAKES` drives, with times drawn by `seed` at which they brake; `done`
    is called after each. Models see closed stop lines if `signals`.

    Returns:
        counts by model and kind of drive.
    """
    counts = {name: dict.fromkeys(DRIVE_KINDS, NO_COUNTS) for name in models}
    for ego in egos:
        for drive in drives(scenario, ego, np.random.default_rng([seed, ego])):
            remaining = _scenes(scenario, drive, signals)
            while scenes := list(islice(remaining, SCENES_PER_BATCH)):
                for name, model in models.items():
                    for scene, path in zip(scenes, _ego_paths(model, scenes), strict=True):
                        counts[name][drive.kind] += ConflictCounts.of(*scene.judge(path))
        done()
    return counts


@dataclass(frozen=True)
class _Scene:
    """A step of a drive, with the further drive and the futures of m other agents, with which forecasts are compared.

    Attributes:
        inputs: inputs of a model for the agents within the ROI, the ego in row `ego`.
        lane_frames: of those whose lanes bend.
        size: (2,) length and width of the ego [m].
        box: (m, HORIZON, 3) logged x, y [m] and yaw [rad] of the others.
        there: (m, HORIZON) whether they are on the road.
        sizes: (m, 2) their lengths and widths [m].
        path: (HORIZON, 3) x, y, yaw of the ego; its last pose after the end of the drive.
        horizons: (5,) whether the drive lasts for these horizons.
    """

    inputs: AgentInputs
    lane_frames: LaneFrames
    ego: int
    size: FloatArray
    box: FloatArray
    there: BoolArray
    sizes: FloatArray
    path: FloatArray
    horizons: BoolArray

    def judge(self, path: FloatArray) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Returns masks (m, 5) of conflicts that `path` (HORIZON, 3) predicts, of real ones, and of counted pairs."""
        predicted, real = self._within(path), self._within(self.path)
        return predicted, real, np.broadcast_to(self.horizons, predicted.shape)

    def _within(self, path: FloatArray) -> BoolArray:
        """Returns a mask (m, 5) of the others that the ego overlaps within 1 to 5 s along `path` (HORIZON, 3)."""
        dx, dy = self.box[..., 0] - path[:, 0], self.box[..., 1] - path[:, 1]
        sizes = self.sizes[:, 0, None], self.sizes[:, 1, None]
        hit = boxes_overlap(dx, dy, path[:, 2], self.box[..., 2], (self.size[0], self.size[1]), sizes) & self.there
        return np.logical_or.accumulate(hit, axis=1)[:, AT_SECONDS]


def _scenes(scenario: Scenario, drive: Drive, signals: bool) -> Iterator[_Scene]:
    """Yields the steps of `drive` after the history, at the models' rate, up to 1 s before its end."""
    log, tracks = scenario.log, _tracks(scenario, drive, signals)
    row, steps = log.row(drive.ego), len(drive.x)
    size = np.array([log.length[row], log.width[row]])
    others = np.flatnonzero(log.ids != drive.ego)
    met = np.zeros(len(others), np.bool_)
    for step in range(0, steps - round(SECONDS[0] / STEP_S), STRIDE):
        valid = log.valid[others, step]
        dx, dy = log.x[others, step] - drive.x[step], log.y[others, step] - drive.y[step]
        yaws = np.full(len(others), drive.yaw[step]), log.yaw[others, step]
        met |= valid & boxes_overlap(dx, dy, *yaws, (size[0], size[1]), (log.length[others], log.width[others]))
        if step < scenario.history_steps:
            continue
        later = step + STRIDE * np.arange(1, HORIZON + 1)
        own = np.minimum(later, steps - 1)
        instants = np.minimum(later, log.steps - 1)
        near = others[valid & ~met & (np.hypot(dx, dy) <= scenario.roi_m)]
        rows = tracks.rows_at(scenario.start_frame + step)
        past, observed = tracks.history(rows)
        inputs = agent_inputs(tracks.motion[past], observed, tracks.size[rows], tracks.heading[rows], tracks.raster)
        inside = np.hypot(*(tracks.motion[rows, :2] - (drive.x[step], drive.y[step])).T) <= scenario.roi_m
        rows = rows[inside]
        grid = np.ix_(near, instants)
        yield _Scene(
            inputs=inputs.take(inside),
            lane_frames=tracks.lane_frames(rows),
            ego=int(np.flatnonzero(tracks.vehicle[rows] == drive.ego)[0]),
            size=size,
            box=np.stack([log.x[grid], log.y[grid], log.yaw[grid]], axis=-1),
            there=log.valid[grid] & (later < log.steps),
            sizes=np.stack([log.length[near], log.width[near]], axis=-1),
            path=np.stack([drive.x[own], drive.y[own], drive.yaw[own]], axis=-1),
            horizons=np.array([step + round(second / STEP_S) < steps for second in SECONDS]),
        )


def _tracks(scenario: Scenario, drive: Drive, signals: bool) -> Tracks:
    """Returns the recording of `scenario`, with the ego's rows replaced by `drive`, and none after its end.

    With `signals`, closed stop lines are among them.
    """
    table = scenario.recording.table
    step = table["frame"].to_numpy() - scenario.start_frame
    ego = table["vehicle_id"].to_numpy() == drive.ego
    table = table[~ego | (step < len(drive.x))].copy()
    ego = table["vehicle_id"].to_numpy() == drive.ego
    steps = table.loc[ego, "frame"].to_numpy() - scenario.start_frame
    for column in ("x", "y", "yaw", "speed"):
        table.loc[ego, column] = getattr(drive, column)[steps]
    shown = scenario.signals if signals else None
    return Tracks.from_table(scenario.name, table, scenario.net_path, signals=shown, begin=scenario.start_frame)


def _ego_paths(model: SceneModel, scenes: Sequence[_Scene]) -> FloatArray:
    """Returns poses (len(scenes), HORIZON, 3) of the egos in their most probable forecasts: x, y, yaw in frame map."""
    device = next((parameter.device for parameter in model.parameters()), torch.device("cpu"))
    with torch.inference_mode():
        batch = inputs_batch([scene.inputs for scene in scenes], [scene.lane_frames for scene in scenes])
        mean = model(batch.to(device), decode="best").mean
    path = numbers(mean[range(len(scenes)), [scene.ego for scene in scenes], 0])
    frame = np.array([scene.inputs.frame[scene.ego] for scene in scenes])
    yaw = np.array([scene.inputs.state[scene.ego, 3] for scene in scenes], np.float64)
    headings = frame[:, 2:] + path_headings(path, yaw)
    return np.concatenate([in_map(path, frame), headings[..., None]], axis=-1)


def _share(part: int, whole: int) -> float | None:
    return float(part / whole) if whole else None
