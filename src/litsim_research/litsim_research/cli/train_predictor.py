"""`train`: a learned predictor from recordings; progress, learning curves, weights, resumable."""

from __future__ import annotations

import argparse
import os
import shlex
from importlib import resources
from pathlib import Path

from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import at_least_one, print_how_to_resume, program, training_folder
from litsim_sim.core.errors import EXIT_INTERRUPTED
from litsim_sim.io.yaml_input import read_yaml, validate_yaml

CORES = len(os.sched_getaffinity(0))
DATA_HELP = "Recordings are searched in the current folder, beside the configuration, and in LITSIM_DATA."


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research train predictor``."""
    p = Parser(prog="train predictor", description=__doc__, epilog=DATA_HELP)
    names = ", ".join(sorted(packaged_configs()))
    p.add_argument("--config", default="default", help=f"{names}, or a YAML file (default: default)")
    p.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER", help="folder of weights, checkpoint, curves, history"
    )
    p.add_argument("--fraction", type=float, metavar="F", help="share of the vehicles, instead of the configuration's")
    p.add_argument("--resume", action="store_true", help="resume from the checkpoint in FOLDER")
    p.add_argument("--epochs", type=int, metavar="N", help="replaces the configuration's")
    p.add_argument("--seed", type=int, metavar="N", help="replaces the configuration's")
    p.add_argument("--device", default="auto", help="device of torch: cpu, cuda, cuda:1 (default: cuda if available)")
    p.add_argument("--threads", type=at_least_one, metavar="N", help="threads of torch on the CPU (default: all cores)")
    workers = "processes that make batches ahead; the result does not depend on it (default: half of the cores)"
    p.add_argument("--workers", type=at_least_one, metavar="N", default=max(1, CORES // 2), help=workers)
    return p


def packaged_configs() -> dict[str, Path]:
    """Returns the paths of the training configurations that come with the package, by name."""
    folder = Path(str(resources.files("litsim_research"))) / "configs"
    return {path.stem: path for path in folder.glob("*.yaml")}


@program
def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run litsim_research train predictor``."""
    arguments = parser().parse_args(argv)

    import torch

    from litsim_research.predictors.checkpoint import CHECKPOINT
    from litsim_research.predictors.device import check_device
    from litsim_research.predictors.training.config import TrainingConfig
    from litsim_research.predictors.training.data import Locator
    from litsim_research.predictors.training.training import CURVES, WEIGHTS, Training

    file = packaged_configs().get(arguments.config, Path(arguments.config))
    chosen = {name: getattr(arguments, name) for name in ("fraction", "epochs", "seed")}
    chosen = {name: value for name, value in chosen.items() if value is not None}
    config = read_yaml(file, TrainingConfig)
    config = validate_yaml(config.model_dump() | chosen, TrainingConfig, "command line", "")
    folder: Path = arguments.out
    training_folder(folder, CHECKPOINT, resume=arguments.resume)
    if arguments.threads is not None:
        torch.set_num_threads(arguments.threads)
    device = arguments.device
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    check_device(device)
    name = arguments.config if arguments.config in packaged_configs() else file.name
    options = [word for key, value in chosen.items() for word in (f"--{key}", str(value))]
    command = shlex.join(
        ["ros2", "run", "litsim_research", "train", "predictor", "--config", name, *options, "--out", folder.name]
    )
    training = Training(config, folder, Locator(file.parent), command, device, arguments.workers)
    if arguments.resume:
        training.read(folder / CHECKPOINT)
    training.run()
    if not training.history:
        return EXIT_INTERRUPTED
    last = training.history[-1]
    print(f"epoch {last['epoch']:.0f} of {config.epochs}: validation RMSE {last['val_rmse_5']:.2f} m at 5 s")
    print(f"{folder / WEIGHTS}\n{folder / CURVES}")
    if len(training.history) < config.epochs:
        print_how_to_resume()
        return EXIT_INTERRUPTED
    return 0
