"""`analyze BAG`: the measures of a recorded run, as a table and as `metrics.json` beside the bag."""

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
from litsim_sim.errors import InputError

PLOT_FILE = "overview.png"
NOTHING = "-"


def analyze(bag: Path, json_path: Path | None = None, plot_path: Path | None = None) -> dict[str, Any]:
    """Measure the run in `bag` (folder or MCAP file) and write `metrics.json` and `overview.png` beside it.

    Args:
        bag: of the run.
        json_path: where the measures go instead.
        plot_path: where the picture goes instead.

    Returns:
        the tree of `metrics.json`.

    Raises:
        InputError: `bag` is no LitSim run, or the results cannot be written.
    """
    run = read_run(bag)
    metrics = compute_metrics(run)
    folder = run.path.parent
    path = json_path or folder / METRICS_FILE
    try:
        write_metrics(metrics, path)
        path = plot_path or folder / PLOT_FILE
        _plot(run, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return metrics


def _plot(run: Run, path: Path) -> None:
    from litsim_sim.analysis.plots import overview  # matplotlib takes half a second to load

    overview(run, path)


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
    parser = argparse.ArgumentParser(prog="analyze", description=__doc__)
    parser.add_argument("bag", type=Path, help="folder of a run, or its MCAP file")
    parser.add_argument("--json", type=Path, metavar="OUT", help=f"default: {METRICS_FILE} beside the bag")
    parser.add_argument("--plot", type=Path, metavar="PNG", help=f"default: {PLOT_FILE} beside the bag")
    parser.add_argument("--quiet", action="store_true", help="print nothing")
    arguments = parser.parse_args(argv)
    try:
        metrics = analyze(arguments.bag, arguments.json, arguments.plot)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    if not arguments.quiet:
        print_metrics(metrics)


if __name__ == "__main__":
    main()
