"""Build description of litsim_data: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "litsim_data"
# Package data: files opened with importlib.resources.
ENDINGS = ("css", "j2", "json")
DATA = [f"**/*.{ending}" for ending in ENDINGS]
# Folders beside the package that are installed into its share folder.
SHARED = ("config",)

setup(
    name=NAME,
    version="0.1.0",
    description="Recordings of LitSim-ROS in and out: formats, cleaning, maps, generated traffic, mining.",
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
            "data = litsim_data.cli:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.recordings": [
            "ngsim = litsim_data.ngsim.plugin:Official",
            "us101_windows = litsim_data.ngsim.plugin:Windows",
        ],
        "litsim.maps": [
            "commonroad = litsim_data.maps.map_format:CommonRoad",
            "lanelet2 = litsim_data.maps.map_format:Lanelet2",
            "opendrive = litsim_data.maps.map_format:OpenDrive",
        ],
    },
)
