"""Analyze a recorded run: write its measures to files beside its bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from litsim_eval.analysis.metrics import METRICS_FILE, compute_metrics, write_metrics
from litsim_eval.analysis.tables import SERIES_FILE, TAKEOVERS_FILE, write_tables
from litsim_sim.io.files import make_folder, replacing
from litsim_sim.record.run import Run

PLOT_FILE = "overview.png"
FILES = (METRICS_FILE, SERIES_FILE, TAKEOVERS_FILE, PLOT_FILE)


def measure(run: Run, folder: Path) -> dict[str, Any]:
    """Measures a run; returns the contents of `metrics.json`.

    Writes :data:`FILES` to `folder`, each whole or not at all; raises InputError if that is impossible.
    """
    make_folder(folder)
    metrics = compute_metrics(run)
    write_metrics(metrics, folder / METRICS_FILE)
    write_tables(run, folder)
    from litsim_eval.pictures.overview import overview  # matplotlib takes half a second to load

    with replacing(folder / PLOT_FILE) as new:
        overview(run, new)
    return metrics
