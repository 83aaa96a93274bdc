"""Build description of litsim_policy: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "litsim_policy"
# Package data: files opened with importlib.resources, such as configurations, scenarios and nets.
ENDINGS = ("css", "html", "js", "json", "parquet", "pt", "safetensors", "xml", "xml.gz", "yaml")
DATA = [f"**/*.{ending}" for ending in ENDINGS]
# Folders beside the package that are installed into its share folder, where `ros2 launch` and --params-file look.
SHARED = ("config", "launch")

setup(
    name=NAME,
    version="0.1.0",
    description="Conflict detection, takeovers, policies of the background and ego drivers of LitSim-ROS.",
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
            "conflict = litsim_policy.conflict.node:main",
            "policy = litsim_policy.driving.node:main",
            "stages = litsim_policy.driving.stages_node:main",
            "ego = litsim_policy.ego.node:main",
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
        "litsim.egos": [
            "bat = litsim_policy.ego.bat:BatEgo",
            "idm = litsim_policy.ego.idm:IdmEgo",
            "log = litsim_policy.ego.log:LogEgo",
            "perturbed = litsim_policy.ego.perturbed:PerturbedEgo",
        ],
    },
)
