"""`calibrate`: precision and recall of conflict detection by threshold, horizon and spread.

Only tuning egos are used, and the egos of generated segments: generate these with a seed that no reported figure uses.
"""

from __future__ import annotations

import argparse
from itertools import product

import numpy as np
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detector import ConflictDetector
from litsim_predictor.models import DEFAULT_MODEL, PredictorConfig
from litsim_research.predictors.evaluation.calibration import SECONDS, PairScores, score_drives
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.scenario.scenario import Scenario


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
        help="numbers of further manoeuvres in the forecasts; a column for each",
    )
    p.add_argument(
        "--spread",
        nargs="+",
        type=float,
        default=[1.0],
        help="factors on the forecasts' standard deviations; a column for each",
    )
    p.add_argument("--horizon", type=int, choices=SECONDS, default=SECONDS[-1], help="horizon of detection [s]")
    p.add_argument(
        "--thresholds",
        nargs="+",
        type=float,
        default=[0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7],
        help="probabilities of an overlap from which a pair counts as a conflict; a row for each",
    )
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research calibrate``."""
    arguments = parser().parse_args(argv)
    thresholds = np.array(sorted(arguments.thresholds))
    if (thresholds <= 0.0).any() or (thresholds >= 1.0).any():
        raise InputError(f"--thresholds: {thresholds.tolist()}, expected probabilities above 0 and below 1")
    choices = [ParameterOverrides("--modes", {"modes": most})(PredictorConfig()).modes for most in arguments.modes]
    configs = [ParameterOverrides("--spread", {"sigma_scale": scale})(ConflictConfig()) for scale in arguments.spread]
    scenarios = [Scenario.load(name) for name in arguments.scenario]
    table = Table("threshold", title=f"precision / recall, %, {arguments.horizon} s ahead")
    columns = [[f"{threshold:g}" for threshold in thresholds]]
    with tqdm(unit="ego", dynamic_ncols=True) as bar:
        for modes, config in product(choices, configs):
            parts = []
            for scenario in scenarios:
                detector = ConflictDetector(scenario.log, scenario.roi_m, config)
                for ego in scenario.tuning_egos or (scenario.ego_id,):  # a segment has no tuning egos
                    parts.append(score_drives(scenario, ego, detector, arguments.predictor, modes))
                    bar.update()
            curve = PairScores.joined(parts).curve(arguments.horizon, thresholds)
            columns.append([f"{100 * p:.0f} / {100 * r:.0f}" for p, r in zip(*curve, strict=True)])
            table.add_column(f"{arguments.predictor}, {modes} further manoeuvres, spread x {config.sigma_scale:g}")
    for row in zip(*columns, strict=True):
        table.add_row(*row)
    Console().print(table)
