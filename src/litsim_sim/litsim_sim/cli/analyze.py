"""`analyze BAG`: the measures of a recorded run, on the terminal and as files beside the bag."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from litsim_sim.analysis.metrics import METRICS_FILE, compute_metrics, write_metrics
from litsim_sim.analysis.run import Run, read_run
from litsim_sim.analysis.tables import SERIES_FILE, TAKEOVERS_FILE, write_tables
from litsim_sim.errors import InputError
from litsim_sim.files import replacing

PLOT_FILE = "overview.png"
FILES = (METRICS_FILE, SERIES_FILE, TAKEOVERS_FILE, PLOT_FILE)
NOTHING = "-"


def analyze(bag: Path, out: Path | None = None) -> dict[str, Any]:
    """Measure the run in `bag` (folder or MCAP file); write :data:`FILES` beside it, each whole or not at all.

    Args:
        bag: of the run.
        out: folder of the files instead; made where it is missing.

    Returns:
        the tree of `metrics.json`.

    Raises:
        InputError: `bag` is no LitSim run, or the results cannot be written.
    """
    run = read_run(bag)
    folder = out or run.path.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    metrics = compute_metrics(run)
    write_metrics(metrics, folder / METRICS_FILE)
    write_tables(run, folder)
    _plot(run, folder / PLOT_FILE)
    return metrics


def _plot(run: Run, path: Path) -> None:
    from litsim_sim.analysis.plots import overview  # matplotlib takes half a second to load

    with replacing(path) as new:
        overview(run, new)


def print_metrics(metrics: dict[str, Any], console: Console | None = None) -> None:
    """Print the measures that people look at first."""
    console = console or Console()
    title = "{run_id}: {scenario}, ego {ego}, policy {policy}, seed {seed}".format(**metrics)
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, value in _rows(metrics):
        table.add_row(name, value)
    console.print(table)


def _rows(metrics: dict[str, Any]) -> Iterator[tuple[str, str]]:
    collision, back, timing = metrics["collision"], metrics["handback"], metrics["timing"]
    yield "valid", "yes" if metrics["valid"] else f"NO: {metrics['why']}"
    yield "agents", f"{metrics['agents']}, of which {metrics['controlled_agents']} were ever under control"
    touching = f"{collision['pairs']} pairs, {collision['excess']} in excess of the log's {collision['log_floor']}"
    fault = f"ego at fault {collision['ego_at_fault']}, background {collision['background_at_fault']}"
    yield "collisions", f"{touching}; {fault}"
    rates = (_percent(collision["rate_all"]), _percent(collision["rate_controlled"]))
    yield "collision rate", f"{rates[0]} of all, {rates[1]} of controlled agents"
    yield "reactive", "yes" if metrics["reactive"] else "no"
    horizons = list(metrics["ade_all_m"])
    for name, key in (("ADE all", "ade_all_m"), ("ADE controlled", "ade_controlled_m"), ("ADE ego", "ade_ego_m")):
        values = " / ".join(_plain(metrics[key][h]) for h in horizons)
        yield name, f"{values} m at {'/'.join(horizons)} s" if horizons else NOTHING
    yield "progress", f"{_number(metrics['progress_m'], 'm')} (log {_number(metrics['progress_log_m'], 'm')})"
    share = _percent(metrics["relevant_ratio"])
    yield "takeovers", f"{metrics['takeovers']} ({share} of agents), {metrics['false_alarms']} false alarms"
    jumps = f"{back['max_position_jump_m']:.3f} m, {back['max_speed_jump_mps']:.2f} m/s"
    jumps += f", {back['max_yaw_jump_rad']:.3f} rad"
    yield "hand-backs", f"{back['count']}, mean residual {_number(back['residual_m'], 'm')}; largest jump {jumps}"
    ego, others = metrics["comfort"]["ego"], metrics["comfort"]["controlled"]
    yield "hard brakes", f"ego {ego['hard_brakes'] if ego else NOTHING}, controlled agents {others['hard_brakes']}"
    guarded = others["guarded"]
    yield "guarded", f"{guarded['count']} of the policy's agent-steps ({_percent(guarded['share'])})"
    yield "lock-step", f"{metrics['lockstep']['missed']} missed answers, {metrics['lockstep']['gaps']} gaps"
    factor = timing["realtime_factor"]
    yield "wall time", f"{_number(timing['wall_s'], 's')}, {NOTHING if factor is None else f'{factor:.2f}'} x real time"
    stages = (f"{stage} {t['median']:.1f}/{t['max']:.1f}" for stage, t in timing["stage_ms"].items())
    yield "stages, median/max ms", ", ".join(stages) or NOTHING
    yield "digest", metrics["digest"][:16]


def _plain(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.2f}"


def _number(value: float | None, unit: str) -> str:
    return NOTHING if value is None else f"{value:.2f} {unit}"


def _percent(value: float | None) -> str:
    return NOTHING if value is None else f"{100 * value:.1f} %"


def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_sim analyze``."""
    parser = argparse.ArgumentParser(prog="analyze", description=__doc__, epilog=f"Files: {', '.join(FILES)}.")
    parser.add_argument("bag", type=Path, help="folder of a run, or its MCAP file")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="default: beside the bag")
    parser.add_argument("--quiet", action="store_true", help="print nothing")
    arguments = parser.parse_args(argv)
    try:
        metrics = analyze(arguments.bag, arguments.out)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    if not arguments.quiet:
        print_metrics(metrics)


if __name__ == "__main__":
    main()
