"""Build description of litsim_predictor: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "litsim_predictor"
# Files that code opens with importlib.resources; configurations, scenarios, nets and what they embed.
ENDINGS = ("css", "html", "js", "json", "onnx", "parquet", "safetensors", "xml", "xml.gz", "yaml")
DATA = [f"**/*.{ending}" for ending in ENDINGS]
# Folders beside the package that are installed into its share folder, where `ros2 launch` and --params-file look.
SHARED = ("config", "launch")

setup(
    name=NAME,
    version="0.1.0",
    description="Joint predictors of LitSim-ROS, kinematic and learned, and their node.",
    license="Apache-2.0",
    maintainer="LitSim-ROS maintainers",
    maintainer_email="maintainers@litsim.invalid",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: DATA},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *((f"share/{NAME}/{name}", sorted(map(str, Path(name).iterdir()))) for name in SHARED if Path(name).is_dir()),
    ],
    zip_safe=False,
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},  # by which `colcon test` knows what runs test/
    entry_points={
        "console_scripts": [
            "predictor = litsim_predictor.predictor_node:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.stages": ["predictor = litsim_predictor.models:predictor_stage"],
        "litsim.predictors": [
            "bat = litsim_predictor.models:Bat",
            "cs_lstm = litsim_predictor.models:CsLstm",
            "default = litsim_predictor.models:Default",
            "kinematic = litsim_predictor.models:Kinematic",
            "paper = litsim_predictor.models:Paper",
        ],
    },
)
