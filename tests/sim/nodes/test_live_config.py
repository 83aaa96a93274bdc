"""The RViz configuration and the Foxglove layout name topics, types and fields that there are."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosidl_parser.definition import AbstractNestedType

from litsim_sim.ros import topics
from litsim_sim.ros.definitions import type_name

CONFIG = Path(__file__).resolve().parents[3] / "src/litsim_sim/config"
TOPICS = {each.name: each for each in vars(topics).values() if isinstance(each, topics.Topic)}
SHOWN = {topic.name for topic in (*topics.MARKERS, topics.LANES)}
RVIZ_TYPES = {  # of the stock displays
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    "rviz_default_plugins/Path": "nav_msgs/msg/Path",
    "rviz_default_plugins/Odometry": "nav_msgs/msg/Odometry",
}


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((CONFIG / "litsim_foxglove.json").read_text())
    return found


def panels(node: Any) -> Iterator[str]:
    """Panels in the tree of a layout."""
    if isinstance(node, str):
        yield node
    else:
        assert node["direction"] in ("row", "column")
        yield from (*panels(node["first"]), *panels(node["second"]))


def field_type(message: Any, path: str) -> str:
    """Type of the field at a message path, whose arrays are sliced or indexed."""
    slots = message.SLOT_TYPES
    kind: Any = None
    for part in path.split("."):
        name, index = re.fullmatch(r"(\w+)(\[[^]]*\])?", part).groups()  # type: ignore[union-attr]
        fields = list(message.get_fields_and_field_types())
        assert name in fields, f"{message.__name__} has no field {name}; it has {fields}"
        kind = slots[fields.index(name)]
        if isinstance(kind, AbstractNestedType):
            assert index, f"{name} is an array"
            kind = kind.value_type
        else:
            assert not index, f"{name} is no array"
        if hasattr(kind, "namespaces"):
            module = __import__(".".join(kind.namespaces), fromlist=[kind.name])
            message = getattr(module, kind.name)
            slots = message.SLOT_TYPES
    return str(getattr(kind, "typename", getattr(kind, "name", kind)))


def test_rviz_shows_topics_by_their_types_and_qos() -> None:
    manager = yaml.safe_load((CONFIG / "litsim.rviz").read_text())["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    shown = {display["Topic"]["Value"]: display for display in manager["Displays"] if "Topic" in display}
    assert shown.keys() >= SHOWN
    for name, display in shown.items():
        topic = TOPICS[name]
        assert RVIZ_TYPES[display["Class"]] == type_name(topic.type), name
        latched = display["Topic"]["Durability Policy"] == "Transient Local"
        assert latched == topic.latched, name


def test_every_panel_of_the_layout_has_its_place(layout: dict[str, Any]) -> None:
    placed = list(panels(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])
    assert {name.split("!")[0] for name in placed} == {"3D", "Plot", "Table", "RawMessages"}
    assert layout["playbackConfig"]["speed"] == 1


def test_the_scene_of_the_layout_names_topics_that_it_can_draw(layout: dict[str, Any]) -> None:
    scene = layout["configById"]["3D!scene"]
    assert scene["topics"].keys() >= SHOWN
    assert {type_name(TOPICS[name].type) for name in scene["topics"]} <= set(RVIZ_TYPES.values())
    assert scene["followTf"] == "map"


def test_paths_of_the_layout_lead_to_fields(layout: dict[str, Any]) -> None:
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())]
    assert "/litsim/ego/state.twist.twist.linear.x" in paths
    assert {"/litsim/ego/control.acceleration", "/litsim/ego/applied.acceleration"} <= set(paths)  # own, external
    for path in paths:
        topic, _, field = path.partition(".")
        assert field_type(TOPICS[topic].type, field) in ("double", "float"), path
    tables = [panel["topicPath"] for panel in layout["configById"].values() if "topicPath" in panel]
    assert "/litsim/takeovers.takeovers[:]" in tables
    for path in tables:
        topic, _, field = path.partition(".")
        assert topic in TOPICS
        assert not field or field_type(TOPICS[topic].type, field) == "Takeover"


def test_what_the_layout_needs_is_served_or_in_the_scene_of_a_record(layout: dict[str, Any]) -> None:
    named = set(re.findall(r"/litsim/[a-z_/]+", json.dumps(layout)))
    assert named <= {topic.name for topic in (*topics.RECORDED_TOPICS, *topics.MARKERS, topics.LIGHT_MARKERS)}
