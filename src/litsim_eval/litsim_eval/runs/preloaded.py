"""Imports for a process from which runs over DDS are forked: those of launcher, nodes, plug-ins, metrics and reports.

A campaign has one such process, so that no run imports them again; see :func:`litsim_sim.launch.forked.preload`.
"""

# ruff: noqa: F401 - imported for the processes that are forked
from __future__ import annotations

from contextlib import suppress

import domain_coordinator

import litsim_eval.report.recorded
import litsim_eval.runs.workers
import litsim_policy.driving.stages_node
import litsim_predictor.inference.networks
import litsim_sim.cli.launch
import litsim_sim.nodes.bridge
import litsim_sim.nodes.recorder
import litsim_sim.world.sumo
from litsim_eval.report.pages import compile_templates
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.nodes.shared import prepare_nodes, prepare_reading

for group in (plugins.STAGES, plugins.POLICIES, plugins.METRICS):
    for name in plugins.names(group):
        with suppress(InputError):  # one that cannot be imported is an error of the runs that need it
            plugins.load(group, name)
prepare_reading()
compile_templates()
prepare_nodes()
