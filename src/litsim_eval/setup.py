"""Build description of litsim_eval: `colcon build` reads it, on stock ROS 2 as on the wheels."""

from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

PACKAGE = ET.parse("package.xml").getroot()
NAME, MAINTAINER = PACKAGE.findtext("name"), PACKAGE.find("maintainer")
ENDINGS = ("css", "j2", "js", "json", "parquet", "yaml")
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
            "run = litsim_eval.cli.run:main",
            "evaluate = litsim_eval.cli.evaluate:main",
            "credibility = litsim_eval.cli.credibility:main",
            "search = litsim_eval.cli.search:main",
            "rerun = litsim_eval.cli.rerun:main",
            "analyze = litsim_eval.cli.analyze:main",
            "report = litsim_eval.cli.report:main",
            "compare = litsim_eval.cli.compare:main",
            "bench = litsim_eval.cli.bench:main",
            "check_ads = litsim_eval.cli.check_ads:main",
        ],
        # See litsim_sim.core.plugins for the groups.
        "litsim.recorded": ["analyze = litsim_eval.report.recorded:RecordedAnalysis"],
        "litsim.listed": ["suites = litsim_eval.campaign.suite:listed_suites"],
    },
)
