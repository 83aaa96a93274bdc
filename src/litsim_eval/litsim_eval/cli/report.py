"""`report RUN`: show a run, or a whole campaign, as one HTML file."""

from __future__ import annotations

import argparse
from pathlib import Path

from litsim_eval.campaign.results import is_campaign, read_campaign
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval report``."""
    p = Parser(prog="report", description=__doc__)
    p.add_argument("run", type=Path, help="folder of a run, its MCAP file, or the folder of a campaign")
    p.add_argument("--out", type=Path, metavar="HTML", help="default: report.html (experiment.html) in the folder")
    p.add_argument("--quiet", action="store_true", help="print nothing")
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Runs ``ros2 run litsim_eval report``."""
    arguments = parser().parse_args(argv)
    if is_campaign(arguments.run):
        from litsim_eval.report.experiment import write_experiment_report

        path = write_experiment_report(read_campaign(arguments.run), arguments.out, quiet=arguments.quiet)
    else:
        from litsim_eval.report.run_report import write_report

        path = write_report(arguments.run, arguments.out)
    if not arguments.quiet:
        print(f"{path} ({path.stat().st_size / 1e6:.2f} MB)")


if __name__ == "__main__":
    main()
