"""The nodes of a run: who takes part, and with which parameters."""

import json
from pathlib import Path

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.launch.nodes import GraphNode, in_one_process, nodes_of
from litsim_sim.scenario.run_info import RunPlan


def nodes(ego: str = "idm", policy: str = "litsim", interface: str = "auto", **plan: object) -> dict[str, GraphNode]:
    run = RunPlan.load("demo", ego, policy, **plan)  # type: ignore[arg-type]
    made = nodes_of(run, "demo", Path("bags/a"), overwrite=True, ego_interface=interface)
    return {node.name: node for node in made}


def test_the_bridge_comes_first_and_then_the_recorder() -> None:
    assert list(nodes()) == ["bridge", "recorder", "ego", "policy", "conflict", "predictor"]
    assert list(nodes(policy="replay")) == ["bridge", "recorder", "ego"]
    assert list(nodes("external", "replay")) == ["bridge", "recorder"]


def test_who_drives_the_ego_is_a_parameter_of_its_node() -> None:
    found = nodes("perturbed")
    assert (found["ego"].package, found["ego"].executable) == ("litsim_policy", "ego")
    assert found["ego"].parameters["driver"] == "perturbed"
    assert (found["bridge"].package, found["bridge"].executable) == ("litsim_sim", "bridge")


def test_what_is_set_reaches_its_node_and_the_bridge_knows_of_all() -> None:
    settings = [("conflict", "horizon", 2.5), ("ego", "headway", 2.0), ("bridge", "handshake_timeout_s", 9.0)]
    found = nodes(predictor="kinematic", ego_id=7, seed=5, vehicle={"lag_s": 0.2}, settings=settings)
    assert found["conflict"].parameters == {"horizon": 2.5}
    assert found["predictor"].parameters == {"model": "kinematic"}
    assert found["policy"].parameters == {}
    assert found["recorder"].parameters == {"output": "bags/a", "overwrite": True}
    bridge = found["bridge"].parameters
    assert (bridge["ego_id"], bridge["seed"], bridge["vehicle.lag_s"], bridge["scenario"]) == (7, 5, 0.2, "demo")
    assert bridge["handshake_timeout_s"] == 9.0
    told = {"predictor": {"model": "kinematic"}, "conflict": {"horizon": 2.5}, "ego": {"headway": 2.0}}
    assert json.loads(bridge["stage_parameters"]) == told


def test_the_stages_and_our_ego_share_a_process_each_with_its_parameters() -> None:
    settings = [("conflict", "horizon", 2.5), ("ego", "headway", 2.0)]
    shared = in_one_process(list(nodes(predictor="kinematic", settings=settings).values()))
    assert [node.name for node in shared] == ["bridge", "recorder", "stages"]
    one = shared[-1]
    assert (one.package, one.executable) == ("litsim_policy", "stages")
    assert one.several == ("ego", "predictor", "conflict", "policy")
    given = {"predictor:model": "kinematic", "conflict:horizon": 2.5, "ego:headway": 2.0, "ego:driver": "idm"}
    assert one.parameters == given


def test_a_stack_has_processes_of_its_own() -> None:
    assert [node.name for node in in_one_process(list(nodes("external").values()))] == ["bridge", "recorder", "stages"]


def test_a_run_without_a_policy_has_nothing_to_share() -> None:
    alone = list(nodes(policy="replay").values())
    assert in_one_process(alone) == alone


def test_who_takes_no_part_cannot_be_set() -> None:
    with pytest.raises(InputError, match="no stage of this run: policy; expected bridge, ego, recorder"):
        nodes(policy="replay", settings=[("policy", "weights", "mine")])
    assert "predictor" not in nodes(policy="replay", predictor="kinematic"), "nothing is forecast in a replay"


@pytest.mark.parametrize(("node", "name", "value"), [("bridge", "ego", "log"), ("recorder", "output", "elsewhere")])
def test_what_the_options_decide_cannot_be_set_otherwise(node: str, name: str, value: str) -> None:
    with pytest.raises(InputError, match=rf"parameter {node}\.{name} cannot be set: the options of the run decide it"):
        nodes(settings=[(node, name, value)])


def test_only_an_external_ego_has_an_interface() -> None:
    assert nodes("external", interface="twist")["bridge"].parameters["ego_interface"] == "twist"
    with pytest.raises(InputError, match="--ego-interface twist: the ego is idm"):
        nodes(interface="twist")
