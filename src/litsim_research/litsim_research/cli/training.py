"""`train`: train a predictor, policy C, or a baseline; `train WHAT --help` has the options of each."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program

TRAININGS = {
    "predictor": ("litsim_research.cli.train_predictor", "a predictor of traffic"),
    "policy": ("litsim_research.policies.train", "policy C"),
    "imitation": ("litsim_research.imitation.train", "the baselines gail and rail"),
    "reactions": ("litsim_research.reactions.train", "by how much people change their speed behind a leader"),
    "simnet": ("litsim_research.imitation.simnet_train", "the baseline simnet"),
    "followers": ("litsim_research.reactions.calibrate", "the car following of policy litsim"),
}
"""Modules of the trainings, which are imported on call, so that a lack of torch is reported."""


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research train``."""
    purposes = "; ".join(f"{name}: {purpose}" for name, (_, purpose) in TRAININGS.items())
    p = Parser(prog="train", description=__doc__)
    p.add_argument("what", choices=tuple(TRAININGS), help=purposes)
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research train``."""
    words = sys.argv[1:] if argv is None else argv
    what = parser().parse_args(words[:1]).what
    import_module(TRAININGS[what][0]).main(words[1:])
