"""Build description of litsim_sim: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "litsim_sim"
# Files that code opens with importlib.resources; configurations, scenarios, nets and what they embed.
ENDINGS = ("css", "j2", "js", "json", "parquet", "safetensors", "txt", "xml", "xml.gz", "yaml")
DATA = [f"**/*.{ending}" for ending in ENDINGS]
# Folders beside the package that are installed into its share folder, where `ros2 launch` and --params-file look.
SHARED = ("config", "launch")

setup(
    name=NAME,
    version="0.1.0",
    description="Scenarios, the SUMO world, bridge, recorder and launcher of LitSim-ROS.",
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
            "bridge = litsim_sim.nodes.bridge:main",
            "recorder = litsim_sim.nodes.recorder:main",
            "launch = litsim_sim.cli.launch:main",
            "replay = litsim_sim.cli.replay:main",
            "live = litsim_sim.cli.live:main",
            "compile = litsim_sim.cli.compile:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.stages": [
            "bridge = litsim_sim.nodes.bridge_options:bridge_stage",
            "recorder = litsim_sim.nodes.recorder_options:recorder_stage",
        ],
    },
)
