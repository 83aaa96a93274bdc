"""Print an exact pin of every package in this environment, for requirements/constraints.txt.

    .venv/bin/python tools/freeze.py > requirements/constraints.txt

`pip freeze` would also list the modules inside the ROS wheels (std_msgs and the like), which pip cannot install by
those names. To move versions, empty constraints.txt, change requirements/*.txt, run `make distclean setup` and then
this on Python 3.11, for which some packages stop at older versions than for 3.12; then `make lock`, which adds the
hashes that the set-up asks for, and try the pins on 3.12.
"""

from __future__ import annotations

import argparse
from importlib import metadata

LEFT_OUT = {
    "pip",  # comes with the virtual environment; nothing depends on its version
    "torch",  # torch.txt pins it; a second pin keeps pip from saying plainly that it has no CPU build
}


def installed_wheels() -> dict[str, str]:
    """Returns name and version of every package that pip installed here: those with metadata of a wheel."""
    wheels = {}
    for distribution in metadata.distributions():
        if distribution.read_text("WHEEL") and distribution.read_text("INSTALLER"):
            name = distribution.metadata["Name"].lower().replace("_", "-").replace(".", "-")
            wheels[name] = distribution.version
    return {name: version for name, version in wheels.items() if name not in LEFT_OUT}


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    print("# Every package that `make setup` installs; written by tools/freeze.py, tried on Python 3.11 and 3.12.")
    for name, version in sorted(installed_wheels().items()):
        print(f"{name}=={version}")


if __name__ == "__main__":
    main()
