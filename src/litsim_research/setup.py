"""Build description of litsim_research: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "litsim_research"
# Package data: files opened with importlib.resources.
ENDINGS = ("json", "safetensors", "yaml")
DATA = [f"**/*.{ending}" for ending in ENDINGS]
# Folders beside the package that are installed into its share folder.
SHARED = ("config",)

setup(
    name=NAME,
    version="0.1.0",
    description="Research of LitSim-ROS: training, experiments of the paper, learned baselines.",
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
            "train = litsim_research.cli.training:main",
            "score = litsim_research.cli.score:main",
            "export = litsim_research.cli.export:main",
            "paper = litsim_research.cli.paper:main",
            "calibrate = litsim_research.cli.calibrate:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.policies": [
            "gail = litsim_research.baselines.imitation_policy:Gail",
            "idm = litsim_research.baselines.idm_policy:IdmPolicy",
            "rail = litsim_research.baselines.imitation_policy:Rail",
            "simnet = litsim_research.baselines.simnet.plugin:Simnet",
        ],
        "litsim.predictors": ["oracle = litsim_research.oracle:Oracle"],
        "litsim.networks": ["torch = litsim_research.predictors.eager:load"],
    },
)
