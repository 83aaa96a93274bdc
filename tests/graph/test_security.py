"""The policy for DDS Security beside what nodes on a running graph have, and how secured runs end on the wheels."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from litsim_sim.scenario.recording import Recording, RecordingHeader

GROUPS = {"east": ["WA_0", "WA_1"], "left": ["WA_2"]}
CHANGES = [[0.0, "east", "green"], [0.0, "left", "red"]]
POLICY = Path(__file__).resolve().parents[2] / "src/litsim_sim/config/security.xml"
STACK, ANSWER = "/standard_ego", "/litsim/ego/twist"
PATIENCE_S = 100.0  # for everybody to be there, and to have found each other


def allowed(text: str) -> dict[str, dict[str, list[str]]]:
    """By full name of a node, what a policy allows it to do with which topics and services."""
    found = {}
    for profile in ET.fromstring(text).iter("profile"):
        namespace = profile.attrib["ns"].rstrip("/")
        name = f"{namespace}/{profile.attrib['node']}"
        rules: dict[str, list[str]] = {kind: [] for kind in ("publish", "subscribe", "reply", "request")}
        for rule in profile:
            ((verb, word),) = rule.attrib.items()
            assert word == "ALLOW"
            rules[verb] = sorted(str(each.text).replace("~", name) for each in rule)
        assert found.setdefault(name, rules) == rules  # the egos, each in an enclave of its own, are nodes of one kind
    return found


def one_car() -> pd.DataFrame:
    """It comes up to the first signal of the packaged net urban_like."""
    frame = np.arange(36)
    same = {"yaw": 0.0, "speed": 10.0, "acceleration": 0.0, "length": 4.5, "width": 2.0, "kind": 0, "lane": -1}
    return pd.DataFrame({"vehicle_id": 1, "frame": frame, "x": -125.0 + frame, "y": -4.95, **same})


def test_nodes_may_do_what_they_do_and_nothing_else(graph: Any) -> None:
    """A run that needs all there is: of an external ego, with signals and a policy, beside it an ego, and a live view.

    The bridge waits for the stack, which never answers, and does not hear the ego, which does: so it listens to the
    timing, too, as it does when it waits.
    """
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    may = allowed(POLICY.read_text().replace("minimal_ads", "standard_ego"))
    of_stack = may.pop(STACK)
    scenario = graph.scenario(net="urban_like", ego=1, signals={"groups": GROUPS, "changes": CHANGES})
    Recording.from_table(RecordingHeader("one"), one_car(), "one").write(graph.folder / "traffic.parquet")
    graph.start_node("litsim_sim", "recorder", output=graph.folder / "run")
    for package, executable in (
        ("litsim_predictor", "predictor"),
        ("litsim_policy", "conflict"),
        ("litsim_policy", "policy"),
        ("litsim_policy", "ego"),
    ):
        graph.start_node(package, executable)
    graph.start_node("litsim_sim", "live", "--foxglove", "--port", "0")
    graph.start_script("standard_ego.py", "--fault", "silence", "--at", 0)
    given = {"policy": "litsim", "ego": "external", "ego_interface": "twist", "external_timeout_s": 2 * PATIENCE_S}
    bridge = graph.start_node("litsim_sim", "bridge", scenario=scenario, progress="none", **given)
    wanted = graph.folder / "wanted.json"
    wanted.write_text(json.dumps(may))
    done = graph.finish(graph.start_script("onlooker.py", wanted, PATIENCE_S, STACK, ANSWER))
    assert done.returncode == 0, done.stderr
    assert bridge.poll() is None, bridge.communicate()
    found = json.loads(done.stdout)
    stack = found.pop(STACK)
    assert found == may
    assert all(set(names) <= set(of_stack[kind]) for kind, names in stack.items())
    assert ANSWER in stack["publish"]


def logs(bag: Path) -> dict[str, str]:
    """What each node has said that has said anything: the launcher ends all once the first has failed."""
    found = {each.stem: each.read_text() for each in (bag / "log").glob("*.log")}
    return {name: text for name, text in found.items() if text}


def test_each_node_of_a_run_is_in_an_enclave_of_its_own(graph: Any) -> None:
    """Whether or not the middleware can protect anything; that of the wheels says that it cannot."""
    bag, keys = graph.folder / "run", graph.folder / "keys"
    words = ("--scenario", graph.scenario(), "--policy", "replay", "--ego", "log", "--out", bag)
    secured = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_KEYSTORE": str(keys)}
    done = graph.launch(*words, **secured)
    assert done.returncode == 2
    assert "ROS_SECURITY_STRATEGY is '', expected 'Enforce'" in done.stderr
    assert not bag.exists()

    secured["ROS_SECURITY_STRATEGY"] = "Enforce"
    done = graph.launch(*words, **secured)
    assert done.returncode == 1
    enclaves = {"bridge": "bridge", "recorder": "recorder", "ego": "ego"}
    said = logs(bag)
    assert said
    for name, text in said.items():
        assert f"directory '{keys}/enclaves/litsim/{enclaves[name]}' does not exist" in text

    for enclave in enclaves.values():  # they find these, and that there are no keys in them or no use for any
        (keys / "enclaves/litsim" / enclave).mkdir(parents=True)
    done = graph.launch(*words, "--overwrite", **secured)
    assert done.returncode == 1
    said = logs(bag)
    assert said
    assert all("error creating node" in text and "does not exist" not in text for text in said.values())
