"""The watch over the publishers of a graph: how many there may be on each topic, and who is one too many."""

import pytest

from litsim_sim.core.stages import BRIDGE, POLICY_STAGES, RECORDER
from litsim_sim.nodes.publishers import STAGES, owners, surplus
from litsim_sim.ros.topics import CONTROLS, EGO_APPLIED, EGO_CONTROL, FOREIGN, RECORDED_TOPICS, SIGNALS, STATUS, TIMING


@pytest.mark.parametrize("external", [False, True])
def test_every_recorded_topic_has_owners_but_those_that_foreign_nodes_publish_on(external: bool) -> None:
    of_run = owners(STAGES, external=external, applied=external, signals=external)
    assert set(RECORDED_TOPICS) - set(of_run) == set(FOREIGN) - (set() if external else {EGO_CONTROL})
    assert of_run[CONTROLS] == ("policy",)
    assert of_run[SIGNALS] == of_run[EGO_APPLIED] == ((BRIDGE,) if external else ())
    assert set(of_run[STATUS]) == {BRIDGE, *STAGES}
    assert set(of_run[STATUS]) - set(of_run[TIMING]) == {RECORDER}


def test_nobody_is_too_many_as_long_as_there_are_no_more_than_owners() -> None:
    assert surplus("/litsim/controls", ["policy"], ["/policy"]) == ""
    assert surplus("/litsim/controls", ["policy"], ["/relay"]) == ""  # of any name
    assert surplus("/litsim/status", ["bridge", "ego"], []) == ""


def test_an_idle_stage_is_no_stranger_and_a_second_one_of_the_run_is() -> None:
    names = owners((*POLICY_STAGES, RECORDER), external=True, applied=True, signals=False)[STATUS]
    nodes = [f"/{name}" for name in names]
    assert surplus("/litsim/status", names, [*nodes, "/ego"]) == ""
    assert surplus("/litsim/status", names, [*nodes, "/ego", "/policy"]).startswith("/policy: publishes on ")


def test_a_topic_that_the_run_does_without_is_for_idle_stages_alone() -> None:
    names = owners((RECORDER,), external=True, applied=True, signals=False)[CONTROLS]
    assert names == () and surplus("/litsim/controls", names, ["/policy"]) == ""
    text = surplus("/litsim/controls", names, ["/policy", "/cheat"])
    assert text.startswith("/cheat: publishes on /litsim/controls, expected nobody")


def test_another_bridge_is_called_so() -> None:
    text = surplus("/litsim/run_info", ["bridge"], ["/bridge", "/bridge"])
    assert text == "another bridge publishes on /litsim/run_info in the same domain; each needs a domain of its own"


@pytest.mark.parametrize(
    ("nodes", "who"),
    [
        (["/policy", "/intruder"], "/intruder"),
        (["/policy", "/policy"], "/policy"),
        (["/policy", ""], "an unknown node"),
        (["/b", "/policy", "/a"], "/a, /b"),
    ],
)
def test_a_publisher_too_many_is_named(nodes: list[str], who: str) -> None:
    assert surplus("/litsim/controls", ["policy"], nodes).startswith(
        f"{who}: publishes on /litsim/controls, expected only policy of this run; "
    )
