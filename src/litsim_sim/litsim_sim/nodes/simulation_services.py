"""Services of ``simulation_interfaces`` on the bridge: state of the run, pauses and steps, and what is in the scene.

The package is optional: stock ROS 2 has it, the wheels do not.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from geometry_msgs.msg import Vector3
from rclpy.node import Node

from litsim_sim.core.checks import check_budget
from litsim_sim.core.errors import printable, reason
from litsim_sim.core.geometry import box_corners
from litsim_sim.core.scene import AgentTable, Controller, Kind
from litsim_sim.core.vehicle import HEIGHTS
from litsim_sim.launch.middleware import is_secured
from litsim_sim.ros.messages import header, place_at
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import packaged_scenarios

try:
    from simulation_interfaces import msg as msg  # noqa: PLC0414 - simulation_server has both from here
    from simulation_interfaces import srv as srv  # noqa: PLC0414
except ImportError:
    msg = srv = None

NAMESPACE = "/litsim"
EGO = "ego"
"""Name of the ego among the entities; others are named by their ids."""
REFUSED = {
    "LoadWorld": "a run is one scenario: start another with `litsim launch --scenario NAME`",
    "UnloadWorld": "a run is one scenario: end the launcher to end it",
    "ResetSimulation": "a run is recorded from its first to its last step: launch the scenario again",
    "SpawnEntity": "agents come from the recording of the scenario",
    "SpawnEntities": "agents come from the recording of the scenario",
    "DeleteEntity": "agents leave where their logs end",
    "SetEntityState": "the ego moves by the answers of its driver, others by their logs and the policy",
    "SetEntityInfo": "kinds are those of the recording",
}
"""Services that are there but refuse every request, with the reason."""
OF_SERVER = {"LoadWorld", "UnloadWorld", "ResetSimulation"}
"""Refused services that `serve` has in place of the bridge, see :mod:`.simulation_server`, and its features."""
FEATURES_OF_SERVER = ("SIMULATION_RESET", "WORLD_LOADING", "WORLD_UNLOADING")
FEATURES = (
    "ENTITY_TAGS",
    "ENTITY_BOUNDS",
    "ENTITY_BOUNDS_BOX",
    "ENTITY_BOUNDS_CONVEX",
    "ENTITY_CATEGORIES",
    "ENTITY_STATE_GETTING",
    "ENTITY_INFO_GETTING",
    "SIMULATION_STATE_GETTING",
    "SIMULATION_STATE_SETTING",
    "SIMULATION_STATE_PAUSE",
    "STEP_SIMULATION_SINGLE",
    "STEP_SIMULATION_MULTIPLE",
    "WORLD_INFO_GETTING",
    "AVAILABLE_WORLDS",
)
"""What is supported, by the constants of ``SimulatorFeatures``."""


FILTER_MAX = 1000  # characters of a regular expression, which takes time to compile, and may take it to match
LATER = object()
"""What a callback returns for a response that is sent later: rclpy has no other way, but asks nothing of it."""


class Refused(Exception):
    """A request is refused: with a code of ``Result`` or of the response, and a reason."""


class SimulationServices:
    """The services of one run, on the node of its bridge.

    Attributes:
        paused: whether the run waits after each step until it is told to go on.
    """

    def __init__(self, node: Node, plan: RunPlan, *, served: bool) -> None:
        """Offers the services; a run that is `served` is paused at first, and others load it."""
        self.paused, self._served = served, served
        self._plan = plan
        self._table: AgentTable | None = None  # newest step
        self._steps = 0  # to be made while paused
        self._headers: list[Any] = []  # of requests to step, which wait for their responses
        answers: dict[str, Callable[[Any, Any], object]] = {
            "GetSimulatorFeatures": self._features,
            "GetSimulationState": self._state,
            "SetSimulationState": self._set_state,
            "StepSimulation": self._step,
            "GetEntities": self._entities,
            "GetEntitiesStates": self._states,
            "GetEntityState": self._entity_state,
            "GetEntityInfo": self._entity_info,
            "GetEntityBounds": self._entity_bounds,
            "GetAvailableWorlds": self._worlds,
            "GetCurrentWorld": self._world,
        } | {name: _refuser(why) for name, why in REFUSED.items() if not (served and name in OF_SERVER)}
        services = {
            name: node.create_service(getattr(srv, name), service_name(name), answering(answer))
            for name, answer in answers.items()
        }
        self._stepping = services["StepSimulation"]
        self._send = self._stepping.send_response
        self._stepping.send_response = self._send_or_keep

    @classmethod
    def on(cls, node: Node, plan: RunPlan, *, served: bool) -> SimulationServices | None:
        """The services where their package is installed; none with DDS Security, whose permissions lack them."""
        return None if srv is None or is_secured(os.environ) else cls(node, plan, served=served)

    def show(self, table: AgentTable) -> None:
        """Note the newest step."""
        self._table = table

    def next_step(self) -> bool:
        """Returns whether the run may go on to the next step now; if so, it must."""
        if not self.paused:
            return True
        if self._steps:
            self._steps -= 1
            return True
        self._respond(result_of(msg.Result.RESULT_OK))
        return False

    def close(self) -> None:
        """Tell those who wait for steps that there are no more."""
        self._respond(result_of(msg.Result.RESULT_OPERATION_FAILED, "the run is over"))

    def _send_or_keep(self, response: Any, request_header: Any) -> None:
        """Send the response of a request to step, or keep its header until the steps are made."""
        if response is LATER:
            self._headers.append(request_header)
        else:
            self._send(response, request_header)

    def _respond(self, result: Any) -> None:
        for request_header in self._headers:
            self._send(srv.StepSimulation.Response(result=result), request_header)
        self._headers.clear()

    def _features(self, _: Any, response: Any) -> None:
        names = (*FEATURES, *(FEATURES_OF_SERVER if self._served else ()))
        response.features.features = [getattr(msg.SimulatorFeatures, name) for name in names]
        response.features.custom_info = "LitSim-ROS, docs/ego-interface.md"

    def _state(self, _: Any, response: Any) -> None:
        response.state.state = self._current_state

    @property
    def _current_state(self) -> int:
        states = msg.SimulationState
        return int(states.STATE_PAUSED if self.paused else states.STATE_PLAYING)

    def _set_state(self, request: Any, response: Any) -> None:
        wanted, states = request.state.state, msg.SimulationState
        if wanted == self._current_state:
            raise Refused(response.ALREADY_IN_TARGET_STATE, "it is in this state already")
        if wanted not in {states.STATE_PLAYING, states.STATE_PAUSED}:
            reason = f"state {wanted}: a run plays or is paused; end the launcher to end it"
            raise Refused(msg.Result.RESULT_FEATURE_UNSUPPORTED, reason)
        self.paused, self._steps = wanted == states.STATE_PAUSED, 0
        self._respond(result_of(msg.Result.RESULT_OPERATION_FAILED, "the run was told to go on instead"))

    def _step(self, request: Any, _: Any) -> object:
        if not self.paused:
            raise Refused(msg.Result.RESULT_OPERATION_FAILED, "the run is not paused: set STATE_PAUSED before")
        if self._table is None:
            raise Refused(msg.Result.RESULT_OPERATION_FAILED, "step 0 is not there yet")
        if not request.steps:
            raise Refused(msg.Result.RESULT_OPERATION_FAILED, "steps is 0, expected at least 1")
        self._steps += request.steps
        return LATER

    def _entities(self, request: Any, response: Any) -> None:
        response.entities = [self._name(row) for row in self._filtered(request.filters)]

    def _states(self, request: Any, response: Any) -> None:
        rows = self._filtered(request.filters)
        response.entities = [self._name(row) for row in rows]
        response.states = [self._entity_state_of(row) for row in rows]

    def _entity_state(self, request: Any, response: Any) -> None:
        response.state = self._entity_state_of(self._row(request.entity))

    def _entity_info(self, request: Any, response: Any) -> None:
        row = self._row(request.entity)
        response.info.category.category = self._category(row)
        response.info.tags = self._tags(row)
        response.info.description = f"agent {self._agents.id[row]} of the recording"

    def _entity_bounds(self, request: Any, response: Any) -> None:
        row, table = self._row(request.entity), self._agents
        x, y = 0.5 * float(table.length[row]), 0.5 * float(table.width[row])
        response.bounds.type = msg.Bounds.TYPE_BOX
        upper = Vector3(x=x, y=y, z=HEIGHTS[Kind(int(table.kind[row]))])
        response.bounds.points = [upper, Vector3(x=-x, y=-y, z=0.0)]

    def _worlds(self, request: Any, response: Any) -> None:
        if request.additional_sources and not request.continue_on_error:
            reason = "additional_sources: worlds are the packaged scenarios, or files"
            raise Refused(msg.Result.RESULT_FEATURE_UNSUPPORTED, reason)
        if not request.filter.tags:  # scenarios have none
            response.worlds = [world_of(name) for name in packaged_scenarios()]

    def _world(self, _: Any, response: Any) -> None:
        response.world = world_of(self._plan.scenario.name)

    @property
    def _agents(self) -> AgentTable:
        assert self._table is not None
        return self._table

    def _name(self, row: int) -> str:
        agent = int(self._agents.id[row])
        return EGO if agent == self._plan.scenario.ego_id else str(agent)

    def _row(self, entity: str) -> int:
        """Returns the row of an entity."""
        for row in range(0 if self._table is None else len(self._table)):
            if self._name(row) == entity:
                return row
        raise Refused(msg.Result.RESULT_NOT_FOUND, f"{entity}: no such agent is on the road")

    def _category(self, row: int) -> int:
        kind = Kind(int(self._agents.kind[row]))
        categories = msg.EntityCategory
        if self._name(row) == EGO:
            return int(categories.CATEGORY_ROBOT)
        return int(categories.CATEGORY_HUMAN if kind == Kind.PEDESTRIAN else categories.CATEGORY_DYNAMIC_OBJECT)

    def _tags(self, row: int) -> list[str]:
        """The kind of an agent, and who moves it."""
        table = self._agents
        return [Kind(int(table.kind[row])).name.lower(), Controller(int(table.controller[row])).name.lower()]

    def _entity_state_of(self, row: int) -> Any:
        table = self._agents
        yaw, speed, acceleration = (float(getattr(table, name)[row]) for name in ("yaw", "speed", "acceleration"))
        state = msg.EntityState(header=header(table.step))
        place_at(state.pose, float(table.x[row]), float(table.y[row]), yaw)
        state.twist.linear.x, state.twist.linear.y = speed * np.cos(yaw), speed * np.sin(yaw)
        state.twist.angular.z = float(table.yaw_rate[row])
        forward = state.acceleration.linear
        forward.x, forward.y = acceleration * np.cos(yaw), acceleration * np.sin(yaw)
        return state

    def _filtered(self, filters: Any) -> list[int]:
        """Returns the rows of the agents that pass `filters`."""
        if self._table is None:
            raise Refused(msg.Result.RESULT_INCORRECT_STATE, "step 0 is not there yet")
        try:
            check_budget("characters of the filter", len(filters.filter), FILTER_MAX)
            name, area = re.compile(filters.filter), _area(filters.bounds)
        except (re.error, ValueError, OverflowError, RecursionError) as error:
            raise Refused(msg.Result.RESULT_OPERATION_FAILED, f"filters: {error}") from error
        categories, tags = {category.category for category in filters.categories}, set(filters.tags.tags)
        every = filters.tags.filter_mode == filters.tags.FILTER_MODE_ALL
        table = self._table
        corners = box_corners(table.x, table.y, table.yaw, table.length, table.width)
        return [
            row
            for row in range(len(table))
            if name.search(self._name(row))
            and (not categories or self._category(row) in categories)
            and (not tags or (tags <= set(self._tags(row)) if every else tags & set(self._tags(row))))
            and (area is None or area.intersects(shapely.Polygon(corners[row])))
        ]


def _area(bounds: Any) -> Any:
    """Returns the area of some bounds; None if they are empty.

    Raises:
        ValueError: they have too few points, or not numbers.
    """
    kinds, points = msg.Bounds, [(point.x, point.y) for point in bounds.points]
    if not np.isfinite(points).all():
        raise ValueError("bounds have a point that is not finite")
    if bounds.type == kinds.TYPE_EMPTY:
        return None
    if bounds.type == kinds.TYPE_CONVEX_HULL and len(points) > 2:
        return shapely.MultiPoint(points).convex_hull
    if bounds.type == kinds.TYPE_BOX and len(points) == 2:
        return shapely.box(*np.min(points, axis=0), *np.max(points, axis=0))
    if bounds.type == kinds.TYPE_SPHERE and len(points) == 2:
        return shapely.Point(points[0]).buffer(points[1][0])
    raise ValueError(f"bounds of type {bounds.type} have {len(points)} points; expected 2, of a hull 3 or more")


def _refuser(reason: str) -> Callable[[Any, Any], object]:
    """Returns what refuses every request."""

    def refuse(*_: Any) -> None:
        raise Refused(msg.Result.RESULT_FEATURE_UNSUPPORTED, reason)

    return refuse


def answering(answer: Callable[[Any, Any], object]) -> Callable[[Any, Any], Any]:
    """Returns the callback of a service: `answer` fills the response in, raises :class:`Refused`, or asks for time.

    Any other error is the answer to the request that has caused it.
    """

    def call(request: Any, response: Any) -> Any:
        result = result_of(msg.Result.RESULT_OK)
        try:
            if answer(request, response) is LATER:
                return LATER
        except Refused as refused:
            result = result_of(*refused.args)
        except Exception as error:  # noqa: BLE001 - whatever a client asks for, the run and the server go on
            result = result_of(msg.Result.RESULT_OPERATION_FAILED, printable(reason(error)))
        if hasattr(response, "result"):  # the response with the features has none
            response.result = result
        return response

    return call


def result_of(code: int, text: str = "") -> Any:
    """Returns a result with a code of ``Result`` or of a response, and the text of an error."""
    return msg.Result(result=code, error_message=text)


def world_of(name: str) -> Any:
    """Returns the description of a scenario as a world."""
    return msg.WorldResource(name=name, world_resource=msg.Resource(uri=name))


def service_name(service: str) -> str:
    """Returns the name of a service by its type, such as ``/litsim/get_entities``."""
    return f"{NAMESPACE}/{'_'.join(re.findall('[A-Z][a-z]*', service)).lower()}"
