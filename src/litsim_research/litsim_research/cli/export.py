"""`export`: weights as an ONNX file, which predicts without torch; needs the Python package onnx."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

from litsim_predictor.inference import SHIPPED
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError, not_installed

NEEDED = ("torch", "onnx")


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research export``."""
    p = Parser(prog="export", description=__doc__)
    p.add_argument("--weights", required=True, help=f"{', '.join(SHIPPED)}, or a file of weights (safetensors)")
    p.add_argument("--out", type=Path, required=True, metavar="FILE.onnx", help="file of the graph")
    p.add_argument(
        "--graph-only", action="store_true", help="graph without weights, as packaged beside the safetensors"
    )
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research export``."""
    arguments = parser().parse_args(argv)
    missing = [name for name in NEEDED if not find_spec(name)]
    if missing:
        raise not_installed(missing[0])
    if arguments.out.suffix != ".onnx":
        raise InputError(f"--out {arguments.out}: expected a name that ends in .onnx")
    from litsim_research.predictors.export import write_graph
    from litsim_research.predictors.models.weights import load_model

    write_graph(*load_model(arguments.weights), arguments.out, weights=not arguments.graph_only)
    print(arguments.out)
