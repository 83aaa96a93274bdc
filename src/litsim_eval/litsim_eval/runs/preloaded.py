"""Imports for a process from which runs over DDS are forked: those of launcher, nodes, metrics and reports.

A campaign has one such process, so that no run imports them again; see :func:`litsim_sim.launch.forked.preload`.
"""

# ruff: noqa: F401 - imported for the processes that are forked
from __future__ import annotations

import libsumo

import litsim_eval.analysis.analyze
import litsim_eval.analysis.plots
import litsim_eval.report.run_report
import litsim_eval.report.terminal
import litsim_eval.runs.workers
import litsim_sim.cli.launch
import litsim_sim.nodes.bridge
import litsim_sim.nodes.recorder
from litsim_sim.nodes.shared import prepare_nodes

prepare_nodes()
