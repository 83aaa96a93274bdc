"""`bench`: measure the time per step of the predictors, for several numbers of agents in the region of interest."""

from __future__ import annotations

import argparse
import os

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_eval.benchmark.forecasts import time_models
from litsim_predictor.models import model_names
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import program


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_eval bench forecasts``."""
    p = Parser(prog="bench", description=__doc__, formatter_class=DefaultsFormatter)
    p.add_argument("--models", nargs="+", help="names, or files of weights (default: all packaged models)")
    p.add_argument("--agents", type=int, nargs="+", default=[10, 40, 100, 200], help="numbers of agents, at most 250")
    p.add_argument("--steps", type=int, default=100, help="timed steps, after 4 s of warm-up")
    p.add_argument("--torch", action="store_true", help="also time learned models run by torch")
    return p


@program
def main() -> None:
    """Entry point of ``ros2 run litsim_eval bench forecasts``."""
    arguments = parser().parse_args()
    models = arguments.models or model_names()
    cells: dict[str, list[str]] = {}
    with tqdm(total=len(arguments.agents), unit="number of agents", dynamic_ncols=True) as bar:
        for agents in arguments.agents:
            for model, _, timing in time_models(models, [agents], arguments.steps, by_torch=arguments.torch):
                cells.setdefault(model, []).append(str(timing))
            bar.update()
    table = Table(
        title=f"forecast, ms/step: median (min to max) of {arguments.steps} steps, {os.cpu_count()} CPU cores"
    )
    table.add_column("model")
    for agents in arguments.agents:
        table.add_column(f"{agents} agents", justify="right")
    for model, row in cells.items():
        table.add_row(model, *row)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
