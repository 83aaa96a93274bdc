"""Command-line programs."""

import litsim_sim.cli  # noqa: F401 - for Ctrl-C while a program is loading
