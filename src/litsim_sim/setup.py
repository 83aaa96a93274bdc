"""Build description of litsim_sim: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

PACKAGE = ET.parse("package.xml").getroot()
NAME, MAINTAINER = PACKAGE.findtext("name"), PACKAGE.find("maintainer")
ENDINGS = ("parquet", "txt", "xml", "yaml")
"""Endings of the files that code opens with importlib.resources."""

setup(
    name=NAME,
    version=PACKAGE.findtext("version"),
    description=PACKAGE.findtext("description"),
    license=PACKAGE.findtext("license"),
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.attrib["email"],
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: [f"**/*.{ending}" for ending in ENDINGS]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", [str(path) for path in sorted(Path("config").iterdir())]),
        (f"share/{NAME}/launch", [str(path) for path in sorted(Path("launch").glob("*.py"))]),
    ],
    extras_require={"test": ["pytest"]},  # by which `colcon test` knows what runs test/
    entry_points={
        "console_scripts": [
            "bridge = litsim_sim.nodes.bridge:main",
            "recorder = litsim_sim.nodes.recorder:main",
            "launch = litsim_sim.cli.launch:main",
            "replay = litsim_sim.cli.replay:main",
            "live = litsim_sim.cli.live:main",
            "serve = litsim_sim.cli.serve:main",
            "compile = litsim_sim.cli.compile:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.stages": [
            "bridge = litsim_sim.nodes.options:bridge_stage",
            "recorder = litsim_sim.nodes.options:recorder_stage",
        ],
    },
)
