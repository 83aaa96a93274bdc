"""Importing this makes a process ready to be copied for runs over DDS: launchers, their nodes, measures and reports.

See :func:`litsim_sim.launch.forked.keep_ready`: a campaign has one such process, and imports nothing anew in any run.
"""

from __future__ import annotations

import libsumo  # noqa: F401 - of the bridge

import litsim_sim.analysis.analyze
import litsim_sim.analysis.plots
import litsim_sim.cli.launch
import litsim_sim.nodes.bridge
import litsim_sim.nodes.recorder
import litsim_sim.report.run_report
import litsim_sim.report.terminal  # noqa: F401
from litsim_sim.nodes.shared import prepare_nodes

prepare_nodes()
