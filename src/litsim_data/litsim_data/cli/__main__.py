"""``python -m litsim_data.cli``."""

from litsim_data.cli import main

main()
