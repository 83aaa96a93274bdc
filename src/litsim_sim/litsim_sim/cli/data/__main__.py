"""``python -m litsim_sim.cli.data``."""

from litsim_sim.cli.data import main

main()
