"""Build description of litsim: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from xml.etree import ElementTree as ET

from setuptools import setup

PACKAGE = ET.parse("package.xml").getroot()
NAME, MAINTAINER = PACKAGE.findtext("name"), PACKAGE.find("maintainer")

setup(
    name=NAME,
    version=PACKAGE.findtext("version"),
    description=PACKAGE.findtext("description"),
    license=PACKAGE.findtext("license"),
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.attrib["email"],
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},  # by which `colcon test` knows what runs test/
    entry_points={},
)
