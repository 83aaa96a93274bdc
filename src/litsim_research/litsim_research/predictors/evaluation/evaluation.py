"""Comparison of predictors on the same scenes: models by name, recordings by file, results in one table."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from litsim_data.segments import Part
from litsim_predictor.inference import ON_STREETS, SHIPPED
from litsim_predictor.inference.contract import DT, HISTORY, HORIZON, STRIDE
from litsim_research.predictors.data.batch import SceneBatch
from litsim_research.predictors.data.sources import signals_of_recording, split
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.device import check_device
from litsim_research.predictors.evaluation.conflicts import NO_COUNTS, ConflictCounts
from litsim_research.predictors.evaluation.drives import DriveKind
from litsim_research.predictors.evaluation.scores import ScoreBoard, Scores, by_second
from litsim_research.predictors.models.along_lanes import AlongLanes
from litsim_research.predictors.models.baselines import ConstantTurnRate, ConstantVelocity
from litsim_research.predictors.models.model import SceneModel
from litsim_research.predictors.models.weights import load_model
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.lane_map.lane_graph import of_streets
from litsim_sim.scenario.recorded_net import net_of
from litsim_sim.scenario.recording import Recording

REFERENCE = "constant_velocity"
"""The model that every evaluation includes, and to which errors are related."""
KINEMATIC: dict[str, type[SceneModel]] = {REFERENCE: ConstantVelocity, "kinematic": ConstantTurnRate}
COMPARED = (*KINEMATIC, *SHIPPED)
"""The models that an evaluation compares by default."""
NEEDED_FRAMES = STRIDE * (HISTORY - 1 + HORIZON) + 1

_log = logging.getLogger(__name__)


def load_models(names: Sequence[str], device: str, *, along_lanes: bool) -> dict[str, SceneModel]:
    """Returns models by name or file of weights, the reference first, ready to predict on `device`.

    Forecasts of learned models follow lanes that bend if `along_lanes`.

    Raises:
        InputError: there is no model of a name, its weights cannot be used, or there is no such device.
    """
    check_device(device)
    ordered = dict.fromkeys([REFERENCE, *names])
    for name in ordered:
        if name not in (*COMPARED, ON_STREETS) and not Path(name).is_file():
            choices = ", ".join((*COMPARED, ON_STREETS))
            raise InputError(f"--models {name}: no such model, expected one of {choices}, or a file of weights")
    models = {name: KINEMATIC[name]() if name in KINEMATIC else load_model(name)[0] for name in ordered}
    if along_lanes:
        models |= {name: AlongLanes(model) for name, model in models.items() if name not in KINEMATIC}
    return {name: model.to(device).eval() for name, model in models.items()}


def on_streets(sources: Sequence[Tracks]) -> bool:
    """Whether `sources` are of nets of streets, on which `default` has the weights :data:`ON_STREETS`.

    Raises:
        InputError: some are, and some are not.
    """
    kinds = {tracks.lanes is not None and of_streets(tracks.lanes.lane_map.lanes) for tracks in sources}
    if len(kinds) > 1:
        raise InputError("recordings of streets and of other roads at once, for which `default` has different weights")
    return kinds.pop()


def recording_tracks(path: Path, net: str | None) -> Tracks:
    """Returns the vehicles of a recording in the neutral schema, on the net `net` or, for None, on its own.

    If the net that the recording names is not found, a warning is logged and the map is empty.

    Raises:
        InputError: the file or `net` cannot be used, or the recording is too short.
    """
    recording = Recording.read(path)
    span = int(np.ptp(recording.table["frame"])) + 1
    if span < NEEDED_FRAMES:
        raise InputError(
            f"{path}: the recording is too short: {span} frames, expected at least {NEEDED_FRAMES} "
            f"({DT * (HISTORY - 1):g} s of history, the present, {DT * HORIZON:g} s of future at {1 / STEP_S:g} Hz)"
        )
    net_path = None
    try:
        net_path = net_of(recording.header, path, net)
    except InputError as error:
        if net:
            raise
        _log.warning("%s; forecasting without a map", error)
    return Tracks.from_table(path.stem, recording.table, net_path, signals=signals_of_recording(recording, net_path))


def part_of(sources: Iterable[Tracks], part: Part | Literal["all"]) -> list[Tracks]:
    """Returns the vehicles of `part` of each of `sources`, split 70/10/20 by vehicle id, without those of other parts.

    Raises:
        InputError: there are none.
    """
    sources = list(sources)
    chosen = sources if part == "all" else [tracks for source in sources for tracks in split(source).get(part, [])]
    if not chosen:
        raise InputError(f"--split {part}: no vehicle is in that part, expected recordings with 10 vehicles or more")
    return chosen


def score(
    models: Mapping[str, SceneModel],
    batches: Iterable[SceneBatch],
    seed: int,
    device: str,
    done: Callable[[int], object],
) -> dict[str, Scores]:
    """Returns scores of `models`, which are on `device`, on the same `batches`; see :mod:`.scores`.

    Samples of the joint ADE are drawn by `seed`, the same for every model; `done` is called with the number of scenes
    of each batch.

    Raises:
        InputError: a forecast is not finite, or there is nothing to score.
    """
    boards = {name: ScoreBoard(seed) for name in models}
    with torch.inference_mode():
        for cpu_batch in batches:
            batch = cpu_batch.to(device)
            for name, model in models.items():
                try:
                    boards[name].add(batch, model(batch, decode="all"))
                except InputError as error:
                    raise InputError(f"model {name}: {error}") from error
            done(len(batch.agent))
    return {name: board.scores() for name, board in boards.items()}


def summary(
    scores: Mapping[str, Scores], conflicts: Mapping[str, Mapping[DriveKind, ConflictCounts]]
) -> dict[str, dict[str, Any]]:
    """Returns scores by model, the RMSE also relative to that of :data:`REFERENCE`; and conflicts if counted."""
    result = {}
    reference = by_second(scores[REFERENCE].rmse)
    for name, of_model in scores.items():
        rmse = by_second(of_model.rmse)
        ratios = {second: rmse[second] / reference[second] if reference[second] > 0.0 else None for second in rmse}
        result[name] = of_model.to_json() | {"ratio_to_constant_velocity": ratios}
        if by_drive := conflicts.get(name):
            result[name]["conflicts"] = sum(by_drive.values(), NO_COUNTS).to_json()
            result[name]["conflicts_by_drive"] = {kind: counts.to_json() for kind, counts in by_drive.items()}
    return result
