"""Build description of litsim_policy: `colcon build` reads it, on stock ROS 2 as on the wheels."""

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
            "conflict = litsim_policy.conflict.node:ConflictNode.main",
            "policy = litsim_policy.driving.node:PolicyNode.main",
            "stages = litsim_policy.driving.stages_node:main",
            "ego = litsim_policy.ego.node:EgoNode.main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.stages": [
            "conflict = litsim_policy.conflict.registry:conflict_stage",
            "policy = litsim_policy.driving.registry:policy_stage",
        ],
        "litsim.policies": [
            "litsim = litsim_policy.driving.policy_c:PolicyC",
            "yield = litsim_policy.driving.yield_policy:YieldPolicy",
        ],
        "litsim.setups": [f"{name} = litsim_policy.setups" for name in ("critic", "paper")],
        "litsim.egos": [
            "bat = litsim_policy.ego.bat:BatEgo",
            "idm = litsim_policy.ego.idm:IdmEgo",
            "log = litsim_policy.ego.log:LogEgo",
            "perturbed = litsim_policy.ego.perturbed:PerturbedEgo",
            "track = litsim_policy.ego.track:TrackEgo",
        ],
        "litsim.ego_batches": ["ego = litsim_policy.ego.batched:BatchedEgos"],
    },
)
