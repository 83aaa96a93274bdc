"""Arguments that define a run, shared by `launch` and `run`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from litsim_sim.core.latency import MEASURED, NAME
from litsim_sim.core.parameters import SET_HELP, one_setting
from litsim_sim.core.stages import BRIDGE
from litsim_sim.core.vehicle import VEHICLE_FIELDS, VehicleModel
from litsim_sim.scenario.policies import policy_choices
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan

END_AFTER_CONTACT: dict[str, Any] = {
    "type": float,
    "metavar": "SECONDS",
    "help": "end a run this long after the ego's first contact; default: as the scenario says, usually not at all",
}
"""Arguments of argparse for the option `--end-after-contact`."""


LATENCY: dict[str, Any] = {
    "type": str,
    "metavar": "SECONDS",
    "help": f"how much later the ego's answers count, whole steps; or {MEASURED}: as long as each takes",
}
"""Arguments of argparse for the option `--latency`."""


def add_run_arguments(p: argparse.ArgumentParser, egos: Sequence[str]) -> None:
    """Add the arguments of a single run with one of `egos`; see :func:`plan_of`."""
    p.add_argument("--scenario", default="demo", help="name of a packaged scenario, or a YAML file")
    external = "; external: your own stack" if EXTERNAL in egos else ""
    p.add_argument("--ego", default="idm", choices=tuple(egos), help=f"what drives the ego{external}")
    p.add_argument("--policy", default="litsim", choices=policy_choices(), help="what moves the background")
    p.add_argument(
        "--predictor", metavar="MODEL", help="packaged model, or file of weights; default: parameter predictor.model"
    )
    p.add_argument("--ego-id", type=int, help="vehicle of the recording that is the ego; default: the scenario's")
    p.add_argument("--seed", type=int, help="seed of all randomness; default: the scenario's")
    p.add_argument("--draw", type=int, help="number of the draw of the background's drivers; default: the scenario's")
    p.add_argument("--end-after-contact", **END_AFTER_CONTACT)
    p.add_argument("--latency", **LATENCY)
    p.add_argument(
        "--vehicle",
        type=_vehicle_value,
        nargs="+",
        default=[],
        metavar="NAME=VALUE",
        help=f"parameters of the ego's vehicle, over the scenario's: {', '.join(VEHICLE_FIELDS)}",
    )
    p.add_argument("--set", type=one_setting, nargs="+", default=[], metavar="STAGE.NAME=VALUE", help=SET_HELP)


def plan_of(arguments: argparse.Namespace) -> RunPlan:
    """Returns the run of arguments of :func:`add_run_arguments`; raises InputError if its scenario cannot be used."""
    return RunPlan.load(
        arguments.scenario,
        arguments.ego,
        arguments.policy,
        predictor=arguments.predictor,
        ego_id=arguments.ego_id,
        seed=arguments.seed,
        draw=arguments.draw,
        end_after_contact_s=arguments.end_after_contact,
        vehicle=dict(arguments.vehicle),
        settings=[*arguments.set, *([] if arguments.latency is None else [(BRIDGE, NAME, arguments.latency)])],
    )


def _vehicle_value(text: str) -> tuple[str, float]:
    """Returns name and value of a field of the vehicle model from the text of an option."""
    name, _, value = text.partition("=")
    try:
        VehicleModel.of({name: float(value)})
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {error}") from error
    return name, float(value)
