"""Common parts of the training programs: arguments, threads, and the message after an interruption."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from litsim_research.predictors.checkpoint import CHECKPOINT
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import at_least_one, print_how_to_resume, training_folder


def training_parser(prog: str, doc: str | None, example: str) -> argparse.ArgumentParser:
    """Parser of the program `prog`, described by the first line of `doc`; `example` is a file for ``--config``."""
    p = Parser(prog=prog, description=(doc or "").splitlines()[0])
    p.add_argument("--config", type=Path, required=True, help=f"YAML file, such as {example}")
    p.add_argument("--out", type=Path, required=True, help="folder of the results")
    p.add_argument("--resume", action="store_true", help="resume from the checkpoint in --out")
    p.add_argument("--threads", type=at_least_one, default=1, help="threads of torch; default %(default)s")
    return p


@contextmanager
def training_program(arguments: argparse.Namespace) -> Iterator[None]:
    """Make the output folder, set the number of threads, and tell how to resume if the training is interrupted.

    Raises:
        InputError: see :func:`litsim_sim.cli.program.training_folder`.
    """
    out: Path = arguments.out
    training_folder(out, CHECKPOINT, resume=arguments.resume)
    torch.set_num_threads(arguments.threads)
    try:
        yield
    except KeyboardInterrupt:
        if (out / CHECKPOINT).exists():
            print_how_to_resume()
        raise
