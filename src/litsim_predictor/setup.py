"""Build description of litsim_predictor: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

PACKAGE = ET.parse("package.xml").getroot()
NAME, MAINTAINER = PACKAGE.findtext("name"), PACKAGE.find("maintainer")
ENDINGS = ("onnx", "safetensors")
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
            "predictor = litsim_predictor.ros.node:PredictorNode.main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.stages": ["predictor = litsim_predictor.models:predictor_stage"],
        "litsim.predictors": [
            "bat = litsim_predictor.models:Bat",
            "cs_lstm = litsim_predictor.models:CsLstm",
            "default = litsim_predictor.models:Default",
            "kinematic = litsim_predictor.kinematic:KinematicPredictor",
            "paper = litsim_predictor.models:Paper",
        ],
    },
)
