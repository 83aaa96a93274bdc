"""Build description of litsim_research: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

PACKAGE = ET.parse("package.xml").getroot()
NAME, MAINTAINER = PACKAGE.findtext("name"), PACKAGE.find("maintainer")
ENDINGS = ("safetensors", "yaml")
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
    ],
    extras_require={"test": ["pytest"]},  # by which `colcon test` knows what runs test/
    entry_points={
        "console_scripts": [
            "train = litsim_research.cli.training:main",
            "score = litsim_research.cli.score:main",
            "export = litsim_research.cli.export:main",
            "calibrate = litsim_research.cli.calibrate:main",
            "paper = litsim_research.cli.paper:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.egos": ["onnx = litsim_research.gym.network_ego:NetworkEgo"],
        "litsim.policies": [
            "gail = litsim_research.baselines.imitation_policy:Gail",
            "idm = litsim_research.baselines.idm_policy:IdmPolicy",
            "rail = litsim_research.baselines.imitation_policy:Rail",
            "rollout = litsim_research.baselines.rollout:Rollout",
            "simnet = litsim_research.baselines.simnet.plugin:Simnet",
        ],
        "litsim.networks": ["torch = litsim_research.predictors.eager:load"],
    },
)
