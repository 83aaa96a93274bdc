"""Build description of litsim_data: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

PACKAGE = ET.parse("package.xml").getroot()
NAME, MAINTAINER = PACKAGE.findtext("name"), PACKAGE.find("maintainer")
ENDINGS = ("csv", "j2", "json", "xml", "yaml")
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
    ],
    extras_require={"test": ["pytest"]},  # by which `colcon test` knows what runs test/
    entry_points={
        "console_scripts": [
            "data = litsim_data.cli:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.maps": [
            "commonroad = litsim_data.maps.map_format:CommonRoad",
            "lanelet2 = litsim_data.maps.map_format:Lanelet2",
            "opendrive = litsim_data.maps.map_format:OpenDrive",
        ],
        "litsim.exports": [
            "commonroad = litsim_data.exports.commonroad:CommonRoad",
            "lanelet2 = litsim_data.exports.lanelet2:Lanelet2",
            "opendrive = litsim_data.exports.opendrive:OpenDrive",
            "openscenario = litsim_data.exports.openscenario:OpenScenario",
            "scene = litsim_data.exports.scene:Scene",
            "sumo = litsim_data.exports.sumo:SumoTrajectories",
            "table = litsim_data.exports.table:Table",
        ],
        "litsim.sources": [
            "argoverse2 = litsim_data.sources.argoverse:Argoverse2",
            "autoware_bag = litsim_data.sources.autoware_bag:AutowareBag",
            "commonroad = litsim_data.sources.commonroad:CommonRoad",
            "highd = litsim_data.sources.level_x:HighD",
            "interaction = litsim_data.sources.interaction:Interaction",
            "levelx = litsim_data.sources.level_x:LevelX",
            "neutral = litsim_data.sources.table:Neutral",
            "ngsim = litsim_data.sources.ngsim:Official",
            "us101_windows = litsim_data.sources.ngsim:Windows",
            "waymo_json = litsim_data.sources.waymo:WaymoJson",
            "waymo_tfrecord = litsim_data.sources.waymo:WaymoRecord",
            "openscenario = litsim_data.sources.openscenario.source:OpenScenario",
            "mappings = litsim_data.sources.table:PublishedTable",
            "osi = litsim_data.sources.osi:OpenSimulationInterface",
            "py123d = litsim_data.sources.py123d:Py123d",
            "scenario_net = litsim_data.sources.scenario_net:ScenarioNet",
            "sumo = litsim_data.sources.sumo:SumoTrajectories",
        ],
    },
)
