"""What the programs that train have in common: their arguments, threads, and what is said when they are interrupted."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import at_least_one


def training_parser(prog: str, doc: str | None, example: str) -> argparse.ArgumentParser:
    """Arguments of the program `prog`, whose module's docstring is `doc`; `example` is a file for ``--config``."""
    p = Parser(prog=prog, description=(doc or "").splitlines()[0])
    p.add_argument("--config", type=Path, required=True, help=f"YAML file, such as {example}")
    p.add_argument("--out", type=Path, required=True, help="folder of the results")
    p.add_argument("--resume", action="store_true", help="resume from the checkpoint in --out")
    p.add_argument("--threads", type=at_least_one, default=1, help="threads of torch; default %(default)s")
    return p


@contextmanager
def training_program(arguments: argparse.Namespace) -> Iterator[None]:
    """The frame of a training: as many threads as its arguments say, and a word when it is interrupted."""
    torch.set_num_threads(arguments.threads)
    try:
        yield
    except KeyboardInterrupt:
        print(f"\ninterrupted; to go on: --resume with --out {arguments.out}", file=sys.stderr)
        raise
