"""The arguments of `evaluate` that define the runs, and the suite made from them, with or without a suite file."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, get_args

from litsim_eval.campaign.case import GRAPH, Case, cases_of
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.part import Part, suite_of_cases
from litsim_eval.campaign.results import is_campaign, read_campaign
from litsim_eval.campaign.suite import CaseEntry, EgoChoice, EgoSetup, Suite, located, packaged_suites, place_of
from litsim_eval.runs.case_run import CaseRefused, check_cases, is_elsewhere
from litsim_sim.cli.program import at_least_one
from litsim_sim.cli.run_arguments import END_AFTER_CONTACT, LATENCY
from litsim_sim.core.errors import InputError
from litsim_sim.core.latency import NAME
from litsim_sim.core.parameters import SET_HELP, not_among, setting
from litsim_sim.core.stages import BRIDGE
from litsim_sim.io.yaml_input import validate_yaml
from litsim_sim.launch.adapters import adapter_names
from litsim_sim.scenario.policies import PolicySetup, policy_choices, setup_of
from litsim_sim.scenario.run_info import EXTERNAL, ego_names

DEFAULTS: dict[str, Any] = {"scenario": ["demo"], "ego": ["idm"]}
"""Of a campaign without a suite file; all others are those of :class:`Suite`."""


def add_suite_arguments(p: argparse.ArgumentParser) -> None:
    """Adds the arguments that define the runs, most with several values; :func:`suite_of` reads them."""
    packaged = ", ".join(packaged_suites())
    p.add_argument(
        "--suite", help=f"YAML file, packaged name ({packaged}), or folder of a campaign; options override its fields"
    )
    p.add_argument("--scenario", nargs="+", help="names of packaged scenarios, or YAML files (default: demo)")
    p.add_argument(
        "--ego-id",
        nargs="+",
        action=_EgoIds,
        metavar="ID",
        help="vehicles of the recordings that are the ego, one run each: ids, a field of the scenarios (egos, tuning, "
        "ego), or all; default: as the suite says, else egos",
    )
    p.add_argument(
        "--ego",
        nargs="+",
        help=f"what drives the ego: {', '.join(_usual_egos())}, or a name of the suite (default: idm)",
    )
    add_policy_arguments(p, also=", or one of the suite (default: replay litsim)")
    p.add_argument("--seeds", nargs="+", type=int, help="a run for each seed; default: the scenario's")
    p.add_argument(
        "--drivers",
        type=at_least_one,
        metavar="N",
        help="a run with each of N draws of the background's drivers, and the probability that a case fails "
        "(default: 1; policy litsim draws them from 2 on)",
    )
    p.add_argument("--end-after-contact", **END_AFTER_CONTACT)
    p.add_argument("--latency", nargs="+", **LATENCY)
    part = p.add_argument_group("part of the suite", "cases that are run; all options together choose them")
    part.add_argument(
        "--case", nargs="+", default=[], metavar="NAME", help="names, their beginnings, or patterns of them"
    )
    part.add_argument("--tag", nargs="+", default=[], metavar="TAG", help="those with one of these tags")
    part.add_argument(
        "--event", nargs="+", default=[], metavar="KIND", help="those in which one of these events happens"
    )
    part.add_argument(
        "--failed-in", type=Path, metavar="CAMPAIGN", help="those that have not passed in this folder of a campaign"
    )
    part.add_argument(
        "--hardest",
        nargs=2,
        metavar=("N", "FIELD"),
        help="the N hardest by a field of their events, such as severity; or, with a campaign as --suite or "
        "--failed-in, of its metrics.json, such as safety.min_own_ttc_s",
    )
    p.add_argument(
        "--warm",
        action="store_true",
        help="let graph and stack stay up from run to run: for a stack that begins anew with each (check_ads --warm)",
    )
    p.add_argument("--criteria", metavar="FILE", help="criteria that judge the runs (YAML); default: the packaged ones")
    p.add_argument(
        "command",
        nargs="*",
        metavar="COMMAND",
        help="after --: command that starts the external ego, once per run; without it, start it yourself",
    )


def add_policy_arguments(p: argparse.ArgumentParser, default: list[str] | None = None, also: str = "") -> None:
    """Adds the arguments that define what moves the background; `also` ends the help on the policies."""
    policies = f"what moves the background: {', '.join(policy_choices())}{also}"
    p.add_argument("--policy", nargs="+", default=default, help=policies)
    p.add_argument("--predictor", nargs="+", metavar="MODEL", help="forecasting model; a variant for each")
    p.add_argument(
        "--set",
        type=setting,
        nargs="+",
        default=[],
        metavar="STAGE.NAME=VALUE[,VALUE]",
        help=f"{SET_HELP}; a variant for each of several values",
    )


def suite_of(arguments: argparse.Namespace) -> Suite:
    """Returns the suite that the arguments describe.

    Raises:
        InputError: a file cannot be used, or the arguments do not fit together.
    """
    base = None if arguments.suite is None else Suite.load(arguments.suite)
    fields: dict[str, Any] = {"cases": _cases(arguments, base), "egos": _setups(arguments, base)}
    if base is None:
        names = arguments.scenario or DEFAULTS["scenario"]
        fields["name"] = Path(names[0]).stem if len(names) == 1 else f"{len(names)} scenarios"
    options = {
        "policies": None if arguments.policy is None else _policies(arguments.policy, base),
        "seeds": arguments.seeds,
        "drivers": arguments.drivers,
        "end_after_contact_s": arguments.end_after_contact,
    }
    fields |= {name: value for name, value in options.items() if value is not None}
    fields["parameters"] = (base.parameters if base else {}) | _varied(arguments)
    if arguments.criteria is not None:
        fields["criteria"] = Criteria.load(arguments.criteria)
    return validate_yaml((base.model_dump() if base else {}) | fields, Suite, arguments.suite or "options", "")


def background_suite(arguments: argparse.Namespace, ego: str) -> Suite:
    """Returns a suite of one case in which `ego` meets what the arguments of :func:`add_policy_arguments` describe.

    `arguments.drivers` is the number of draws of its drivers.

    Raises:
        InputError: a policy is unknown, or the arguments do not fit together.
    """
    fields = {
        "name": "background",
        "cases": [CaseEntry(scenario=DEFAULTS["scenario"][0])],
        "egos": [EgoSetup(name=ego, kind=ego)],
        "policies": _policies(arguments.policy, None),
        "drivers": arguments.drivers,
        "parameters": _varied(arguments),
    }
    return validate_yaml(fields, Suite, "options", "")


def part_of(arguments: argparse.Namespace) -> Part | None:
    """Returns what chooses the cases to run; None if all of the suite are.

    Raises:
        InputError: a campaign cannot be read, or an argument does not fit.
    """
    if not (arguments.case or arguments.tag or arguments.event or arguments.failed_in or arguments.hardest):
        return None
    failed_in = None if arguments.failed_in is None else read_campaign(arguments.failed_in)
    measured_in = failed_in
    if measured_in is None and arguments.hardest and arguments.suite and is_campaign(Path(arguments.suite)):
        measured_in = read_campaign(Path(arguments.suite))
    hardest = None
    if arguments.hardest:
        count, field = arguments.hardest
        if not (count.isdecimal() and int(count)):
            raise InputError(f"--hardest {count} {field}: expected a number of cases, then a field")
        hardest = int(count), field
    return Part(arguments.case, arguments.tag, arguments.event, failed_in, hardest, measured_in)


def cases_to_run(arguments: argparse.Namespace, suite: Suite, versions: dict[str, str]) -> tuple[Suite, list[Case]]:
    """Returns the part of `suite` that the arguments choose, as a suite and as cases.

    Raises:
        InputError: an argument does not fit.
    """
    cases, part = cases_of(suite, graph=arguments.graph, with_versions=versions), part_of(arguments)
    if part is None:
        return suite, cases
    cases = part.of(cases)
    return suite_of_cases(suite, cases), cases


def refuse_unusable(arguments: argparse.Namespace, cases: Sequence[Case]) -> None:
    """Checks that all `cases` can be run.

    Raises:
        InputError: one cannot; where it is the suite's fault, the message names the place in its file.
    """
    try:
        check_cases(cases)
    except CaseRefused as error:  # for a parameter that only its stage can check
        where = f"{place_of(arguments.suite, error.setting)}: " if arguments.suite else ""
        raise InputError(f"{where}{error}") from error
    warm = [case for case in cases if case.execution_mode == GRAPH and not (is_elsewhere(case) or case.ego.adapter)]
    if arguments.warm and (getattr(arguments, "ray", None) or not warm):
        raise InputError("--warm: expected runs over DDS with the command of a stack or --graph, and no --ray")


def _varied(arguments: argparse.Namespace) -> dict[str, Any]:
    """Returns the values of each parameter that the arguments give, by `stage.name`."""
    models = {"predictor.model": arguments.predictor} if arguments.predictor else {}
    if getattr(arguments, "latency", None):
        models[f"{BRIDGE}.{NAME}"] = arguments.latency
    return models | {f"{stage}.{name}": values for stage, name, values in arguments.set}


def _cases(arguments: argparse.Namespace, base: Suite | None) -> list[CaseEntry]:
    if arguments.scenario or base is None:
        names = arguments.scenario or DEFAULTS["scenario"]
        chosen = {} if arguments.ego_id is None else {"ego_id": arguments.ego_id}
        return [CaseEntry(scenario=located(name, Path.cwd()), **chosen) for name in names]
    if arguments.ego_id is None:
        return base.cases
    return [CaseEntry(**(entry.model_dump() | {"ego_id": arguments.ego_id})) for entry in base.cases]


def _setups(arguments: argparse.Namespace, base: Suite | None) -> list[EgoSetup]:
    """Returns the ego drivers; the command of the arguments becomes that of the external one."""
    of_base = {setup.name: setup for setup in (base.egos if base else [])}
    names: Sequence[str] = arguments.ego or (tuple(of_base) if base else DEFAULTS["ego"])
    _check_names("--ego", names, {*of_base, *_usual_egos()})
    setups = [of_base.get(name) or EgoSetup(name=name, kind=name) for name in names]
    external = [setup for setup in setups if setup.kind == EXTERNAL]
    if arguments.command:
        if len(external) != 1:
            many = ", ".join(setup.name for setup in external) or "none"
            raise InputError(f"{shlex.join(arguments.command)}: external egos: {many}; expected one for this command")
        here = {"command": list(arguments.command), "folder": str(Path.cwd()), "environment": []}
        started = external[0].model_copy(update=here)
        return [started if setup is external[0] else setup for setup in setups]
    if len(elsewhere := [setup.name for setup in external if not setup.command]) > 1:
        raise InputError(f"{', '.join(elsewhere)}: external egos without a command, expected at most one")
    return setups


def _usual_egos() -> tuple[str, ...]:
    """Names of egos that need no suite."""
    return (*ego_names(), *adapter_names())


def _policies(names: Sequence[str], base: Suite | None) -> list[str | PolicySetup]:
    """Returns the policies of these names, as the suite has them where it has them."""
    of_base = {setup_of(policy).name: policy for policy in (base.policies if base else [])}
    _check_names("--policy", names, {*of_base, *policy_choices()})
    return [of_base.get(name, name) for name in names]


def _check_names(option: str, names: Sequence[str], allowed: Collection[str]) -> None:
    """Checks that an option was given `known` names only; raises InputError if it was given others."""
    if unknown := [name for name in names if name not in allowed]:
        raise InputError(f"{option} {not_among(unknown, allowed)}")


class _EgoIds(argparse.Action):
    """Parses the vehicles that are egos: a word, or ids separated by commas or spaces."""

    def __call__(self, _: object, namespace: argparse.Namespace, values: Any, __: object = None) -> None:
        words = [word for word in ",".join(values).split(",") if word]
        if len(words) == 1 and words[0] in get_args(EgoChoice):
            chosen: str | list[int] = words[0]
        elif words and all(word.isascii() and word.isdigit() for word in words):
            chosen = [int(word) for word in words]
        else:
            raise argparse.ArgumentError(self, f"{' '.join(values)}: expected {', '.join(get_args(EgoChoice))}, or ids")
        setattr(namespace, self.dest, chosen)
