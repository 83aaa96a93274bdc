"""The build backend of `pip install .`: that of setuptools, with the entry points of each package's setup.py.

It is not at work in `colcon build`, which installs each package by its own setup.py. In the one wheel that pip builds,
a program such as `run` is no command of its own: it is a verb of the command `litsim` (litsim_sim.cli.verbs).
"""

from __future__ import annotations

import shutil
from contextlib import chdir
from importlib import import_module
from pathlib import Path

import setuptools.build_meta

get_requires_for_build_wheel = setuptools.build_meta.get_requires_for_build_wheel
prepare_metadata_for_build_wheel = setuptools.build_meta.prepare_metadata_for_build_wheel
build_wheel = setuptools.build_meta.build_wheel

run_setup = import_module("distutils.core").run_setup  # which setuptools brings since Python 3.12
FOLDER = Path("build/pip")
"""All that pip leaves; pyproject.toml names it to setuptools, and the file of entry points in it."""
COMMANDS, VERBS = "console_scripts", "litsim.verbs"
COMMAND = "litsim = litsim_sim.cli.verbs:main"


def entry_points() -> dict[str, list[str]]:
    """Returns the entry points of all packages, by group."""
    groups: dict[str, list[str]] = {COMMANDS: [COMMAND]}
    for file in sorted(Path("src").glob("*/setup.py")):
        with chdir(file.parent):
            distribution = run_setup("setup.py", stop_after="init")
        for group, points in distribution.entry_points.items():
            groups.setdefault(VERBS if group == COMMANDS else group, []).extend(points)
    return groups


shutil.rmtree(FOLDER, ignore_errors=True)  # else setuptools would pack what was removed since
FOLDER.mkdir(parents=True)
sections = ("\n".join((f"[{group}]", *points, "")) for group, points in entry_points().items())
(FOLDER / "entry_points.ini").write_text("\n".join(sections))
