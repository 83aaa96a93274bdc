"""Services of simulation_interfaces: pauses and steps, who is there, and what is refused with a reason."""

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("simulation_interfaces", reason="simulation_interfaces is not built (tools/interfaces.sh)")

from geometry_msgs.msg import Vector3
from simulation_interfaces import msg, srv

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import AgentTable, Controller, Kind
from litsim_sim.nodes.simulation_server import SimulationServer
from litsim_sim.nodes.simulation_services import FEATURES, REFUSED, SimulationServices, answering

RESULT = msg.Result


class Services:
    """The services of a run without a node, by the names of their types."""

    def __init__(self) -> None:
        self.calls: dict[str, Any] = {}
        self.sent: list[tuple[Any, str]] = []
        plan: Any = SimpleNamespace(scenario=SimpleNamespace(ego_id=1, name="demo"))
        node: Any = self
        self.run = SimulationServices(node, plan, served=False)

    def create_service(self, kind: Any, topic: str, call: Any) -> Any:
        self.calls[kind.__name__] = (kind, topic, call)
        service = SimpleNamespace(send_response=lambda response, header: self.sent.append((response, header)))
        if kind is srv.StepSimulation:
            self.stepping = service
        return service

    def call(self, name: str, **fields: Any) -> Any:
        kind, _, call = self.calls[name]
        return call(kind.Request(**fields), kind.Response())

    def step(self, steps: int, header: str) -> None:
        """Requests steps as the executor does."""
        self.stepping.send_response(self.call("StepSimulation", steps=steps), header)


@pytest.fixture
def services() -> Services:
    return Services()


@pytest.fixture
def scene(services: Services) -> Services:
    """The ego in the middle, a car ahead of it, and a pedestrian farther away."""
    columns = {"x": [0.0, 20.0, 40.0], "y": [0.0, 0.0, 10.0], "yaw": [0.5 * np.pi, 0.0, 0.0], "speed": [10.0, 5.0, 1.0]}
    sizes = {
        "length": [4.0, 4.0, 0.6],
        "width": [2.0, 2.0, 0.6],
        "acceleration": [2.0, 0.0, 0.0],
        "yaw_rate": [0.1, 0, 0],
    }
    services.run.show(
        AgentTable(
            7,
            id=np.array([1, 12, 30]),
            kind=np.array([Kind.CAR, Kind.CAR, Kind.PEDESTRIAN], np.uint8),
            controller=np.array([Controller.EGO, Controller.POLICY, Controller.LOG], np.uint8),
            **{name: np.array(values, np.float64) for name, values in (columns | sizes).items()},
        )
    )
    return services


def test_names_are_those_of_the_types(services: Services) -> None:
    assert services.calls["GetEntitiesStates"][1] == "/litsim/get_entities_states"
    told = services.call("GetSimulatorFeatures").features.features
    assert list(told) == [getattr(msg.SimulatorFeatures, name) for name in FEATURES]


def test_a_run_pauses_and_makes_as_many_steps_as_it_is_told(scene: Services) -> None:
    states = msg.SimulationState
    assert scene.run.next_step()
    scene.step(1, "too early")
    assert (scene.sent.pop()[0].result.result, scene.run.paused) == (RESULT.RESULT_OPERATION_FAILED, False)
    pause = states(state=states.STATE_PAUSED)
    assert scene.call("SetSimulationState", state=pause).result.result == RESULT.RESULT_OK
    assert scene.call("GetSimulationState").state.state == states.STATE_PAUSED
    assert scene.call("SetSimulationState", state=pause).result.result == 101  # already
    assert not scene.run.next_step()
    scene.step(2, "two")
    assert [scene.run.next_step(), scene.run.next_step()] == [True, True]
    assert scene.sent == []  # the second step is under way
    assert not scene.run.next_step()
    assert [(response.result.result, header) for response, header in scene.sent] == [(RESULT.RESULT_OK, "two")]
    scene.step(5, "more")
    scene.call("SetSimulationState", state=states(state=states.STATE_PLAYING))
    assert scene.run.next_step()
    assert scene.sent[1][0].result.result == RESULT.RESULT_OPERATION_FAILED
    refused = scene.call("SetSimulationState", state=states(state=states.STATE_STOPPED)).result
    assert (refused.result, "end the launcher" in refused.error_message) == (RESULT.RESULT_FEATURE_UNSUPPORTED, True)


def test_those_who_wait_for_steps_hear_of_the_end(scene: Services) -> None:
    scene.call("SetSimulationState", state=msg.SimulationState(state=msg.SimulationState.STATE_PAUSED))
    scene.step(9, "late")
    scene.run.close()
    ((response, header),) = scene.sent
    assert (header, response.result.error_message) == ("late", "the run is over")


def test_entities_are_the_agents(scene: Services) -> None:
    found = scene.call("GetEntitiesStates")
    assert (found.result.result, list(found.entities)) == (RESULT.RESULT_OK, ["ego", "12", "30"])
    ego = found.states[0]
    assert (ego.header.frame_id, ego.header.stamp.nanosec) == ("map", 700_000_000)
    assert (ego.twist.linear.x, ego.twist.linear.y) == (pytest.approx(0.0), 10.0)  # in frame map
    assert (ego.acceleration.linear.y, ego.twist.angular.z) == (2.0, 0.1)
    assert scene.call("GetEntityState", entity="12").state.pose.position.x == 20.0
    info = scene.call("GetEntityInfo", entity="30").info
    assert (info.category.category, list(info.tags)) == (msg.EntityCategory.CATEGORY_HUMAN, ["pedestrian", "log"])
    upper, lower = scene.call("GetEntityBounds", entity="12").bounds.points
    assert (upper.x, upper.y, upper.z, lower.x) == (2.0, 1.0, 1.5, -2.0)
    assert scene.call("GetEntityInfo", entity="99").result.result == RESULT.RESULT_NOT_FOUND


def bounds(kind: int, *points: tuple[float, float]) -> Any:
    return msg.Bounds(type=kind, points=[Vector3(x=x, y=y) for x, y in points])


@pytest.mark.parametrize(
    ("filters", "names"),
    [
        ({"filter": "^[0-9]+$"}, ["12", "30"]),
        ({"categories": [msg.EntityCategory(category=msg.EntityCategory.CATEGORY_ROBOT)]}, ["ego"]),
        ({"tags": msg.TagsFilter(tags=["car", "policy"], filter_mode=msg.TagsFilter.FILTER_MODE_ALL)}, ["12"]),
        ({"tags": msg.TagsFilter(tags=["pedestrian", "policy"])}, ["12", "30"]),
        ({"bounds": bounds(msg.Bounds.TYPE_SPHERE, (0.0, 0.0), (18.5, 0.0))}, ["ego", "12"]),  # up to its bumper
        ({"bounds": bounds(msg.Bounds.TYPE_BOX, (39.0, 20.0), (50.0, 9.0))}, ["30"]),
        ({"bounds": bounds(msg.Bounds.TYPE_CONVEX_HULL, (-5.0, 0.0), (5.0, 0.0), (0.0, 5.0))}, ["ego"]),
    ],
)
def test_filters(scene: Services, filters: dict[str, Any], names: list[str]) -> None:
    assert list(scene.call("GetEntities", filters=msg.EntityFilters(**filters)).entities) == names


@pytest.mark.parametrize(
    ("filters", "said"),
    [
        ({"filter": 499 * "(" + 499 * ")"}, ""),
        ({"filter": 5000 * "a"}, "filters: characters of the filter: 5000, expected at most 1000"),
        ({"filter": "a{99999999999999999999}"}, "filters: "),
        ({"bounds": bounds(msg.Bounds.TYPE_SPHERE, (0.0, 0.0), (float("nan"), 0.0))}, "filters: bounds have a point"),
        ({"bounds": bounds(msg.Bounds.TYPE_BOX, (float("inf"), 0.0), (1.0, 0.0))}, "filters: bounds have a point"),
        ({"bounds": bounds(msg.Bounds.TYPE_SPHERE, (0.0, 0.0), (1e308, 0.0))}, ""),
    ],
)
def test_no_filter_ends_the_run(scene: Services, filters: dict[str, Any], said: str) -> None:
    result = scene.call("GetEntities", filters=msg.EntityFilters(**filters)).result
    assert result.error_message.startswith(said) and scene.run.next_step()


def test_an_error_of_ours_is_the_answer_to_its_request() -> None:
    def fail(*_: Any) -> None:
        raise KeyError("made")

    result = answering(fail)(None, srv.GetEntities.Response()).result
    assert result.result == RESULT.RESULT_OPERATION_FAILED and "KeyError: 'made'" in result.error_message


def test_a_server_gives_packaged_scenarios_and_files_of_its_folder(tmp_path: Path) -> None:
    server: Any = SimpleNamespace(_worlds=tmp_path / "given")
    (tmp_path / "given").mkdir()
    for name in ("secret.yaml", "given/mine.yaml"):
        (tmp_path / name).write_text("name: mine")
    (tmp_path / "given/link.yaml").symlink_to(tmp_path / "secret.yaml")
    permitted = partial(SimulationServer._permitted, server)
    assert [permitted("demo"), permitted("mine.yaml")] == ["demo", str(tmp_path / "given/mine.yaml")]
    for elsewhere in ("../secret.yaml", str(tmp_path / "secret.yaml"), "link.yaml", "/etc/passwd", "gone.yaml"):
        with pytest.raises(InputError, match=r": no such scenario, expected one of .*demo"):
            permitted(elsewhere)
    server._worlds = None
    with pytest.raises(InputError, match=r"no such scenario"):
        permitted(str(tmp_path / "given/mine.yaml"))


def test_what_cannot_be_done_says_why(scene: Services) -> None:
    for name, reason in REFUSED.items():
        result = scene.call(name).result
        assert (result.result, result.error_message) == (RESULT.RESULT_FEATURE_UNSUPPORTED, reason)
    wrong = scene.call("GetEntities", filters=msg.EntityFilters(filter="(")).result
    assert (wrong.result, wrong.error_message.startswith("filters: ")) == (RESULT.RESULT_OPERATION_FAILED, True)
    early = Services().call("GetEntities").result
    assert (early.result, early.error_message) == (RESULT.RESULT_INCORRECT_STATE, "step 0 is not there yet")
    assert {world.name for world in scene.call("GetAvailableWorlds").worlds} >= {"demo"}
    assert scene.call("GetCurrentWorld").world.world_resource.uri == "demo"
