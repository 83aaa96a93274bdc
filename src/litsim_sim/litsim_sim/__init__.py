"""Scenes, recordings, the SUMO world, bridge, recorder, launcher and analysis."""

import os

from litsim_sim.kernels.processor import choose_code

choose_code(os.environ)  # before anything imports numpy
