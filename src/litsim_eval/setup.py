"""Build description of litsim_eval: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "litsim_eval"
# Package data: files opened with importlib.resources.
ENDINGS = ("css", "j2", "js", "json", "parquet", "xml", "yaml")
DATA = [f"**/*.{ending}" for ending in ENDINGS]
# Folders beside the package that are installed into its share folder.
SHARED = ("config",)

setup(
    name=NAME,
    version="0.1.0",
    description="Evaluation of LitSim-ROS: runs in process, campaigns, measures, reports, benchmarks.",
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
            "run = litsim_eval.cli.run:main",
            "evaluate = litsim_eval.cli.evaluate:main",
            "rerun = litsim_eval.cli.rerun:main",
            "analyze = litsim_eval.cli.analyze:main",
            "report = litsim_eval.cli.report:main",
            "compare = litsim_eval.cli.compare:main",
            "bench = litsim_eval.cli.bench:main",
            "check_ads = litsim_eval.cli.check_ads:main",
            "security = litsim_eval.cli.security:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.recorded": ["analyze = litsim_eval.recorded:analyze_recorded"],
    },
)
