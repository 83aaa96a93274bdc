"""`report RUN`: show a run, or a whole campaign, as one HTML file; also a scene of a run as a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from litsim_eval.campaign.results import is_campaign, read_campaign
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval report``."""
    p = Parser(prog="report", description=__doc__)
    p.add_argument("run", type=Path, help="folder of a run, its MCAP file, or the folder of a campaign")
    p.add_argument("--out", type=Path, metavar="HTML", help="default: report.html (experiment.html) in the folder")
    pictures = p.add_argument_group("picture of a run (no page then, unless --out is given too)")
    pictures.add_argument("--png", type=Path, help="one scene")
    pictures.add_argument("--step", type=int, metavar="K", help="step of the scene; default: an interesting one")
    p.add_argument("--quiet", action="store_true", help="print nothing")
    return p


def report(arguments: argparse.Namespace) -> list[Path]:
    """Writes the files that the arguments request; returns their paths.

    Raises:
        InputError: the input cannot be read, or a file cannot be written.
    """
    written = [] if arguments.png is None else [_write_picture(arguments)]
    if is_campaign(arguments.run):
        from litsim_eval.report.experiment import write_experiment_report

        return [write_experiment_report(read_campaign(arguments.run), arguments.out, quiet=arguments.quiet)]
    if not written or arguments.out is not None:
        from litsim_eval.report.run_report import write_report

        written.append(write_report(arguments.run, arguments.out))
    return written


def _write_picture(arguments: argparse.Namespace) -> Path:
    """Writes the picture that is asked for, and returns its path."""
    if arguments.png.suffix.lower() != ".png":
        raise InputError(f"--png {arguments.png}: expected a name that ends in .png")
    if is_campaign(arguments.run):
        raise InputError(f"{arguments.run}: a campaign, expected one run for --png")
    from litsim_eval.analysis.plots import notable_moment  # matplotlib takes half a second to load
    from litsim_eval.analysis.takeover import ledger
    from litsim_eval.report.pictures import write_png
    from litsim_sim.record.run import read_run

    run = read_run(arguments.run)
    step = notable_moment(run, ledger(run)).step if arguments.step is None else arguments.step
    write_png(run, step, arguments.png)
    path: Path = arguments.png
    return path


@program
def main(argv: list[str] | None = None) -> None:
    """Runs ``ros2 run litsim_eval report``."""
    arguments = parser().parse_args(argv)
    written = report(arguments)
    for path in () if arguments.quiet else written:
        print(f"{path} ({path.stat().st_size / 1e6:.2f} MB)")


if __name__ == "__main__":
    main()
