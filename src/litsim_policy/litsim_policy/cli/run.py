"""`run`: one run in this process, without ROS, with the metrics that a recorded run would have."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tqdm import tqdm

from litsim_policy.run.runner import Runner, record
from litsim_predictor.models import DEFAULT_MODEL, MODELS
from litsim_sim.analysis.metrics import compute_metrics, write_metrics
from litsim_sim.cli.analyze import print_metrics
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import SET_HELP, by_stage, one_setting
from litsim_sim.scenario.run_info import EGOS, POLICIES, RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.sumo import SumoMirror


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_policy run``."""
    p = argparse.ArgumentParser(prog="run", description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--scenario", default="demo", help="name of a packaged scenario, or a YAML file")
    p.add_argument("--ego", default="idm", choices=[e for e in EGOS if e != "external"], help="what drives the ego")
    p.add_argument("--policy", default="litsim", choices=POLICIES, help="what moves the background")
    p.add_argument("--predictor", default=DEFAULT_MODEL, metavar="MODEL", help=f"{', '.join(MODELS)}, or weights")
    p.add_argument("--ego-id", type=int, help="another vehicle of the recording as the ego")
    p.add_argument("--seed", type=int, help="another seed than the scenario's")
    p.add_argument("--set", type=one_setting, nargs="+", default=[], metavar="STAGE.NAME=VALUE", help=SET_HELP)
    p.add_argument("--json", type=Path, help="write the metrics to this file")
    return p


def main() -> None:
    """Entry point of ``ros2 run litsim_policy run``."""
    arguments = parser().parse_args()
    try:
        scenario = Scenario.load(arguments.scenario, ego=arguments.ego_id, seed=arguments.seed)
        plan = RunPlan(scenario, arguments.ego, arguments.policy)
        forecast = [] if arguments.policy == "replay" else [("predictor", "model", arguments.predictor)]
        parameters = by_stage([*forecast, *arguments.set])
        runner = Runner(plan, SumoMirror(scenario.net_path, scenario.seed), parameters)
        with tqdm(total=scenario.total_steps + 1, unit="step", dynamic_ncols=True) as bar:
            metrics = compute_metrics(record(runner, bar.update))
        if arguments.json:
            write_metrics(metrics, arguments.json)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    print_metrics(metrics)


if __name__ == "__main__":
    main()
