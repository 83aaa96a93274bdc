"""`calibrate`: precision and recall of conflict detection by threshold, horizon and spread, and the cost to runs.

Only tuning egos are used, and the egos of generated segments: generate these with a seed that no reported figure uses.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_policy.conflict.config import ConflictConfig
from litsim_predictor.models import DEFAULT_MODEL, PredictorConfig
from litsim_research.calibration.conflict_calibration import (
    COSTS,
    Curve,
    costs,
    draw_calibration,
    recall_curve,
    threshold_for,
)
from litsim_research.calibration.conflict_recall import SECONDS
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.io.files import replacing
from litsim_sim.scenario.run_info import driver_names, policy_names
from litsim_sim.scenario.scenario import Scenario

PRECISION = 0.9  # for which the threshold with the best recall is printed


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research calibrate``."""
    p = Parser(prog="calibrate", description=__doc__, formatter_class=DefaultsFormatter)
    p.add_argument("--scenario", nargs="+", default=["us101_0750"], help="names of packaged scenarios, or YAML files")
    p.add_argument("--predictor", default=DEFAULT_MODEL, metavar="MODEL", help="forecasting model")
    p.add_argument(
        "--modes",
        nargs="+",
        type=int,
        default=[0, 3],
        help="numbers of further manoeuvres in the forecasts; a curve for each",
    )
    p.add_argument(
        "--spread",
        nargs="+",
        type=float,
        default=[1.0],
        help="factors on the forecasts' standard deviations; a curve for each",
    )
    p.add_argument("--horizon", type=int, choices=SECONDS, default=SECONDS[-1], help="horizon of detection [s]")
    p.add_argument(
        "--thresholds",
        nargs="+",
        type=float,
        default=[0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7],
        help="probabilities of an overlap from which a pair counts as a conflict; a point of each curve",
    )
    p.add_argument("--cost", nargs="*", type=float, default=[], help="also run the scenarios with these thresholds")
    egos = ["idm", "perturbed"]
    p.add_argument("--ego", nargs="+", choices=driver_names(), default=egos, help="with --cost: what drives the ego")
    p.add_argument("--policy", choices=policy_names(), default="litsim", help="with --cost: what moves the background")
    p.add_argument("--out", type=Path, metavar="FILE.png", help="write a picture of the curves to this file")
    return p


@program
def main() -> None:
    """Entry point of ``ros2 run litsim_research calibrate``."""
    arguments = parser().parse_args()
    thresholds = np.array(sorted(arguments.thresholds))
    for name, values in (("--thresholds", thresholds), ("--cost", np.array(arguments.cost))):
        if (values <= 0.0).any() or (values >= 1.0).any():
            raise InputError(f"{name}: {values.tolist()}, expected probabilities above 0 and below 1")
    choices = [ParameterOverrides("--modes", {"modes": most})(PredictorConfig()).modes for most in arguments.modes]
    configs = [ParameterOverrides("--spread", {"sigma_scale": scale})(ConflictConfig()) for scale in arguments.spread]
    scenarios = [Scenario.load(name) for name in arguments.scenario]
    curves = []
    with tqdm(unit="ego", dynamic_ncols=True) as bar:
        for modes in choices:
            for config in configs:
                name = f"{arguments.predictor}, {modes} further manoeuvres, spread x {config.sigma_scale:g}"
                curves.append(
                    recall_curve(
                        name, scenarios, arguments.predictor, modes, config, arguments.horizon, thresholds, bar.update
                    )
                )
    _print_curves(curves, arguments.horizon)
    found = {}
    with tqdm(unit="run", dynamic_ncols=True, disable=not arguments.cost) as bar:
        for threshold in sorted(arguments.cost):
            parameters = {
                "predictor": {"model": arguments.predictor},
                "conflict": {"probability_threshold": threshold, "probability_clear": 0.5 * threshold},
            }
            parts = [costs(scenarios, ego, arguments.policy, parameters, bar.update) for ego in arguments.ego]
            found[threshold] = {name: sum(part[name] for part in parts) for name in COSTS}
    if found:
        _print_costs(found)
    if arguments.out is not None:
        with replacing(arguments.out) as path:
            draw_calibration(curves, found, path)


def _print_curves(curves: list[Curve], second: int) -> None:
    table = Table("threshold", *(curve.name for curve in curves), title=f"precision / recall, %, {second} s ahead")
    for k, threshold in enumerate(curves[0].thresholds.tolist()):
        cells = (f"{100 * c.precision[k]:.0f} / {100 * c.recall[k]:.0f}" for c in curves)
        table.add_row(f"{threshold:g}", *cells)
    console = Console()
    console.print(table)
    for curve in curves:
        best = threshold_for(curve, PRECISION)
        said = "never reached" if best is None else f"at {best[0]:g}, recall {100 * best[1]:.0f} %"
        console.print(f"{curve.name}: precision {100 * PRECISION:.0f} % {said}")


def _print_costs(found: dict[float, dict[str, float]]) -> None:
    table = Table("threshold", *COSTS, title="over all runs")
    for threshold, values in sorted(found.items()):
        table.add_row(f"{threshold:g}", *(f"{values[name]:g}" for name in COSTS))
    Console().print(table)


if __name__ == "__main__":
    main()
