"""`data list`: packaged scenarios, nets and suites."""

from __future__ import annotations

import argparse
from typing import Any

import yaml

from litsim_sim.core import plugins
from litsim_sim.scenario.scenario import packaged, packaged_nets, packaged_scenarios


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("list", help="packaged scenarios, nets and suites")
    command.set_defaults(run=run)


def run(_arguments: argparse.Namespace) -> None:
    """Prints what is packaged."""
    print("scenarios:")
    for name in packaged_scenarios():
        fields = yaml.safe_load(packaged(f"scenarios/{name}.yaml").read_text(encoding="utf-8"))
        print(f"  {name:<16}{fields['description']}")
    print("nets:")
    for name in packaged_nets():
        print(f"  {name:<16}{packaged(f'nets/{name}.net.xml')}")
    for kind in plugins.names(plugins.LISTED):
        print(f"{kind}:")
        for name, description in plugins.load(plugins.LISTED, kind)().items():
            print(f"  {name:<16}{description}")
