"""A picture of a stack's latency."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from litsim_eval.check_ads.requirements import latencies
from litsim_eval.check_ads.trace import Evidence
from litsim_sim.core.colours import FAINT
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.files import replacing


def plot_latency(evidence: Evidence, path: Path) -> bool:
    """Writes a PNG of the latency by step and its distribution; returns False without answers, and writes none.

    Raises:
        InputError: the file cannot be written.
    """
    steps, took = latencies(evidence)
    if not steps:
        return False
    figure = Figure(figsize=(11, 4), dpi=100, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    by_step, histogram = figure.subplots(1, 2, width_ratios=(2, 1))
    by_step.plot(steps, took, color="#4878b0", linewidth=1)
    by_step.axhline(1e3 * STEP_S, color=FAINT, linestyle="--", linewidth=1)
    by_step.set(xlabel="step", ylabel="latency [ms]", title="from a step's first publication to its answer")
    by_step.set_ylim(bottom=0.0)
    histogram.hist(took, bins=30, color="#4878b0")
    histogram.set(xlabel="latency [ms]", ylabel="answers")
    with replacing(path) as new:
        figure.savefig(new)
    return True
