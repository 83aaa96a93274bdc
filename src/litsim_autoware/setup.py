"""Build description of litsim_autoware: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from setuptools import find_packages, setup

NAME = "litsim_autoware"

setup(
    name=NAME,
    version="0.1.0",
    description="Autoware at the ego port of LitSim-ROS: its topics and services, both ways.",
    license="Apache-2.0",
    maintainer="LitSim-ROS maintainers",
    maintainer_email="maintainers@litsim.invalid",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["profiles/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    zip_safe=False,
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},  # by which `colcon test` knows what runs test/
    entry_points={
        "console_scripts": ["autoware = litsim_autoware.program:main"],
        # See litsim_sim.core.plugins for the groups.
        "litsim.adapters": [
            "autoware = litsim_autoware.adapter:CORE",
            "autoware_universe = litsim_autoware.adapter:UNIVERSE",
        ],
    },
)
