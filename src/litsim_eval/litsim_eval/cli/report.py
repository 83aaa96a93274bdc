"""`report RUN`: show a run, or a whole campaign, as one HTML file; or runs as a moving picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from litsim_eval.campaign.results import is_campaign, read_campaign
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval report``."""
    p = Parser(prog="report", description=__doc__)
    runs = "folder of a run, its MCAP file, or the folder of a campaign; several runs for a clip"
    p.add_argument("run", type=Path, nargs="+", help=runs)
    p.add_argument("--out", type=Path, metavar="HTML", help="default: report.html (experiment.html) in the folder")
    p.add_argument(
        "--clip",
        type=Path,
        metavar="FILE",
        help="instead, draw the road around the ego at twice the speed as a moving picture (.webp, .gif, .png), of one "
        "run below the other",
    )
    p.add_argument("--quiet", action="store_true", help="print nothing")
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Runs ``ros2 run litsim_eval report``."""
    p = parser()
    arguments = p.parse_args(argv)
    if arguments.clip is None and len(arguments.run) > 1:
        p.error("expected one run, or --clip FILE")
    path = _clip(arguments.run, arguments.clip) if arguments.clip else _page(arguments.run[0], arguments)
    if not arguments.quiet:
        print(f"{path} ({path.stat().st_size / 1e6:.2f} MB)")


def _page(run: Path, arguments: argparse.Namespace) -> Path:
    """Returns the page of a run or of a campaign, written."""
    if is_campaign(run):
        from litsim_eval.report.experiment import write_experiment_report

        return write_experiment_report(read_campaign(run), arguments.out, quiet=arguments.quiet)
    from litsim_eval.report.run_report import write_report

    return write_report(run, arguments.out)


def _clip(runs: list[Path], path: Path) -> Path:
    """Returns the file with a clip of `runs`, written."""
    from litsim_eval.pictures.clip import write_clip
    from litsim_sim.record.run import read_run

    write_clip([read_run(run) for run in runs], path)
    return path
