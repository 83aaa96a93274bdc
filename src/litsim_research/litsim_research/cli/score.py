"""`score`: compare predictors on the same scenes: errors, likelihood, calibration, consistency, conflicts.

Vehicles with 3 s of history and 5 s of future are scored, at 5 Hz: the first 3 s of a track are skipped. Without
--recording or --validation the scenes are those of a scenario, whose egos also leave their log, to see which conflicts
are announced.
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from itertools import product
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_predictor.inference import ON_STREETS
from litsim_predictor.inference.contract import SECONDS
from litsim_predictor.models import DEFAULT_MODEL
from litsim_research.cli.train_predictor import packaged_configs
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing, write_text
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.scenario import Scenario

if TYPE_CHECKING:
    from litsim_research.predictors.data.tracks import Tracks
    from litsim_research.predictors.evaluation.conflicts import ConflictCounts
    from litsim_research.predictors.evaluation.drives import DriveKind
    from litsim_research.predictors.evaluation.scores import Scores
    from litsim_research.predictors.models.model import SceneModel


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research score``."""
    p = Parser(prog="score", description=__doc__, formatter_class=DefaultsFormatter)
    p.add_argument("--models", nargs="+", help="names, or files of weights (default: all packaged models)")
    source = p.add_mutually_exclusive_group()
    source.add_argument(
        "--recording", nargs="+", type=Path, help="recordings in the neutral schema, instead of a scenario"
    )
    source.add_argument(
        "--validation", metavar="CONFIG", help="validation data of this training configuration, instead of a scenario"
    )
    p.add_argument("--net", help="SUMO net of the recordings, packaged or a file; default: as they say")
    p.add_argument("--scenario", default="us101_0750", help="name of a packaged scenario, or a YAML file")
    p.add_argument(
        "--split",
        default="all",
        choices=["all", "train", "val", "test"],
        help="part of the vehicles by id, 70/10/20 per file",
    )
    p.add_argument(
        "--egos", default="egos", choices=["egos", "tuning", "none"], help="egos of the scenario that leave their log"
    )
    p.add_argument(
        "--straight",
        action="store_true",
        help="leave forecasts of learned models straight; runs bend them along lanes",
    )
    p.add_argument("--stride", type=int, default=2, help="frames of 0.1 s from scene to scene")
    p.add_argument(
        "--roi",
        type=float,
        default=0.0,
        metavar="M",
        help="forecast each agent from what is within M metres of it, as around the ego in a run; 0: from everything",
    )
    p.add_argument("--batch", type=int, default=512, help="approximate number of agents in a batch")
    p.add_argument("--seed", type=int, default=0, help="seed of the joint ADE's samples and of the egos' braking")
    p.add_argument("--device", default="cpu", help="device of torch")
    p.add_argument("--json", type=Path, metavar="OUT", help="write all measures here")
    p.add_argument("--plot", type=Path, metavar="OUT.png", help="draw the errors, calibration and conflicts here")
    return p


def evaluate(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Measure what the arguments ask for; returns the measures by model.

    Raises:
        InputError: a model, file, or option cannot be used.
    """
    from litsim_research.predictors.data.scenes import scene_batches
    from litsim_research.predictors.data.tracks import Tracks
    from litsim_research.predictors.evaluation.conflicts import conflict_counts
    from litsim_research.predictors.evaluation.evaluation import (
        COMPARED,
        load_models,
        on_streets,
        part_of,
        recording_tracks,
        score,
        summary,
    )

    for name, least in (("stride", 1), ("batch", 1), ("seed", 0)):
        if getattr(arguments, name) < least:
            raise InputError(f"--{name} {getattr(arguments, name)}: expected {least} or more")
    if not 0.0 <= arguments.roi < float("inf"):
        raise InputError(f"--roi {arguments.roi}: expected 0 or more metres")
    models = load_models(arguments.models or COMPARED, arguments.device, along_lanes=not arguments.straight)
    scenario = None
    if arguments.validation:
        chosen = _validation_tracks(arguments.validation)
    elif arguments.recording:
        chosen = part_of([recording_tracks(path, arguments.net) for path in arguments.recording], arguments.split)
    else:
        scenario = Scenario.load(arguments.scenario)
        tracks = Tracks.from_table(
            scenario.name,
            scenario.recording.table,
            scenario.net_path,
            signals=scenario.signals,
            begin=scenario.start_frame,
        )
        chosen = part_of([tracks], arguments.split)
    if DEFAULT_MODEL in models and on_streets(chosen):
        of_streets = load_models([ON_STREETS], arguments.device, along_lanes=not arguments.straight)
        models[DEFAULT_MODEL] = of_streets[ON_STREETS]
    groups = _by_sight(models, chosen)
    scenes = sum(len(tracks.frames[:: arguments.stride]) for _, shown in groups for tracks in shown)
    scores: dict[str, Scores] = {}
    with tqdm(total=scenes, unit="scene", dynamic_ncols=True, desc="scenes") as bar:
        for alike, shown in groups:
            batches = scene_batches(shown, arguments.batch, arguments.stride, roi_m=arguments.roi)
            scores |= score(alike, batches, arguments.seed, arguments.device, bar.update)
        bar.total = bar.n  # scenes without agents to score are skipped
    conflicts: dict[str, dict[DriveKind, ConflictCounts]] = {}
    if scenario is not None and arguments.egos != "none":
        egos = scenario.egos if arguments.egos == "egos" else scenario.tuning_egos
        with tqdm(total=len(egos) * len(groups), unit="ego", dynamic_ncols=True, desc="conflicts") as bar:
            for signals, (alike, _) in enumerate(groups):
                conflicts |= conflict_counts(alike, scenario, egos, arguments.seed, bar.update, signals=bool(signals))
    result = summary({name: scores[name] for name in models}, conflicts)
    for measures in result.values():
        measures["protocol"] = {
            "sources": [tracks.name for tracks in chosen],
            "split": "val" if arguments.validation else arguments.split,
            "stride_frames": arguments.stride,
            "roi_m": arguments.roi or None,
            "seed": arguments.seed,
            "along_lanes": not arguments.straight,
            "egos": arguments.egos if conflicts else None,
        }
    return result


def _by_sight(
    models: Mapping[str, SceneModel], chosen: Sequence[Tracks]
) -> list[tuple[dict[str, SceneModel], list[Tracks]]]:
    """Returns the models that see no signals with the vehicles alone; then, if any, those that do, with `chosen`."""
    blind = {name: model for name, model in models.items() if not model.sees_signals}
    seeing = {name: model for name, model in models.items() if model.sees_signals}
    groups = [(blind, [tracks.without_lines() for tracks in chosen])]
    return groups + [(seeing, list(chosen))] * bool(seeing)


def _validation_tracks(name: str) -> list[Tracks]:
    """Returns the validation part of the training configuration of that name, or of that file."""
    from litsim_research.predictors.training.config import TrainingConfig
    from litsim_research.predictors.training.data import Locator, load_parts

    file = packaged_configs().get(name, Path(name))
    return [tracks for tracks, _ in load_parts(read_yaml(file, TrainingConfig), Locator(file.parent))["val"]]


def print_table(title: str, result: dict[str, dict[str, Any]]) -> None:
    """Print a table of the measures on stdout, with the models side by side."""
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for model in result:
        table.add_column(Path(model).stem, justify="right", overflow="fold")
    for name, keys in _rows(result):
        table.add_row(name, *(_cell(_entry(measures, keys), keys[0]) for measures in result.values()))
    Console().print(table)
    print("ratio: of the RMSE to constant velocity's; precision, recall: of conflicts of egos that leave their log")


def _rows(result: dict[str, dict[str, Any]]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yields titles of the table's rows, and the keys of what is in them."""
    seconds = [str(second) for second in SECONDS]
    for second in seconds:
        yield f"RMSE@{second} s m", ("rmse", second)
    for second in ("1", "3", "5"):
        yield f"ratio@{second} s", ("ratio_to_constant_velocity", second)
    yield "NLL nats", ("nll",)
    yield "NLL@5 s nats", ("nll_at", "5")
    yield "ADE m", ("ade",)
    yield "minADE m", ("min_ade",)
    yield "joint ADE m", ("joint_ade",)
    yield "in 50 % ellipse %", ("calibration", "50")
    yield "in 90 % ellipse %", ("calibration", "90")
    yield "forecasts overlap %", ("overlap_rate",)
    yield "truth overlaps %", ("overlap_rate_truth",)
    if all("conflicts" in measures for measures in result.values()):
        for measure, second in product(("precision", "recall"), seconds):
            yield f"{measure}@{second} s %", ("conflicts", second, measure)


def _entry(measures: Any, keys: tuple[str, ...]) -> Any:
    """Returns what is at the place `keys` in nested mappings."""
    return reduce(getitem, keys, measures)


def _cell(value: float | None, measure: str) -> str:
    """Returns `value` as in the table; shares are in per cent."""
    if value is None:
        return "-"
    if measure in ("calibration", "overlap_rate", "overlap_rate_truth", "conflicts"):
        return f"{100.0 * value:.1f}"
    return f"{value:.3f}"


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research score``."""
    logging.basicConfig(format="%(levelname)s: %(message)s")
    arguments = parser().parse_args(argv)
    result = evaluate(arguments)
    measures = next(iter(result.values()))
    where = ", ".join(measures["protocol"]["sources"])
    print_table(f"{where}: {measures['samples']} forecasts in {measures['scenes']} scenes", result)
    if arguments.json:
        write_text(arguments.json, json.dumps(result, indent=2, allow_nan=False) + "\n")
    if arguments.plot:
        from litsim_research.predictors.evaluation.plot import draw

        with replacing(arguments.plot) as new:
            draw(result, new)
