"""The parameters of bridge and recorder: the run, how to run it, and where it is recorded."""

from __future__ import annotations

import inspect
from dataclasses import asdict, field, make_dataclass
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, model_validator

from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.latency import NAME as LATENCY
from litsim_sim.core.latency import NONE, latency_steps, latency_text, without_latency
from litsim_sim.core.parameters import ParameterOverrides, Parameters
from litsim_sim.core.quantities import (
    Duration,
    Flag,
    Number,
    OneOf,
    Positive,
    Unit,
    Whole,
    configuration,
    field_type,
    unit,
)
from litsim_sim.core.stages import BRIDGE
from litsim_sim.core.topic_names import INTERFACES
from litsim_sim.core.vehicle import VEHICLE_FIELDS, VehicleModel
from litsim_sim.core.yaml_loader import load_yaml
from litsim_sim.scenario.policies import policy_names
from litsim_sim.scenario.run_info import RunPlan, ego_names, new_execution
from litsim_sim.scenario.scenario import Scenario

OF_THE_SCENARIO = -1
"""Value of a parameter that stands for the scenario's value."""

_TYPES = {name: Annotated[Number, Unit(unit(field_type(VehicleModel, name)))] for name in VEHICLE_FIELDS}
VehicleOptions: Any = configuration(
    make_dataclass(
        "VehicleOptions", [(name, kind, float(OF_THE_SCENARIO)) for name, kind in _TYPES.items()], frozen=True
    )
)
"""The fields of :class:`litsim_sim.core.vehicle.VehicleModel`, each with the value that stands for the scenario's."""
VehicleOptions.__doc__ = "Vehicle model of the ego; -1 is the scenario's.\n\nAttributes:\n" + "\n".join(
    str(inspect.getdoc(model)).partition("Attributes:\n")[2] for model in (VehicleLimits, VehicleModel)
)


@configuration
class BridgeOptions:
    """Parameters of the bridge.

    Attributes:
        scenario: packaged scenario, or a YAML file.
        ego: what drives the ego.
        policy: what moves the background.
        ego_id: id of the recorded vehicle that the ego replaces; -1 is the scenario's.
        seed: seed of all randomness in the run; -1 is the scenario's.
        draw: number of the draw of the background's drivers; -1 is the scenario's.
        end_after_contact_s: time after the ego's first contact at which the run ends; -1 is the scenario's.
        mode: whether the bridge waits for answers, or runs in real time.
        on_missing: what happens in lock-step if an answer is missing.
        on_invalid: what happens if an answer of the ego cannot be used.
        ego_interface: interface of an external ego; auto is that of its first message.
        answer_timeout_s: time limit for the answers to one step.
        handshake_timeout_s: time limit for all stages to get ready, generous for busy machines; stages waited for are
            reported every few seconds.
        external_timeout_s: time limit for an external ego to answer step 0.
        clock: whether the bridge publishes /clock and /tf; false if an adapter of the ego's stack does.
        real_time_factor: simulated time per wall time: of the clock while a step waits, and in real time of the steps.
        served: whether the run was loaded by `serve`: it then waits at step 0 until it is told to go on.
        latency: how much later the ego's answers count, in lock-step as well: measured, as long as each takes, to the
            nearest step; or seconds, whole steps.
        open_loop: whether an external ego's answers count in the history as well, in which it follows its log: what it
            would have done is then on /litsim/ego/applied.
        progress: how the progress of the run is shown.
        vehicle: vehicle model of the ego.
        stage_parameters: values of the stages' parameters, by stage and name, in YAML; they enter the identity of the
            run, but do not set the parameters.
    """

    scenario: str = "demo"
    ego: Annotated[str, OneOf(ego_names)] = "idm"
    policy: Annotated[str, OneOf(policy_names)] = "litsim"
    ego_id: Annotated[Whole, Field(ge=OF_THE_SCENARIO)] = OF_THE_SCENARIO
    seed: Annotated[Whole, Field(ge=OF_THE_SCENARIO)] = OF_THE_SCENARIO
    draw: Annotated[Whole, Field(ge=OF_THE_SCENARIO)] = OF_THE_SCENARIO
    end_after_contact_s: Annotated[Duration, Field(ge=OF_THE_SCENARIO)] = float(OF_THE_SCENARIO)
    mode: Literal["lockstep", "realtime"] = "lockstep"
    on_missing: Literal["stop", "hold"] = "stop"
    on_invalid: Literal["stop", "hold"] = "stop"
    ego_interface: Annotated[str, OneOf(INTERFACES)] = INTERFACES[0]
    answer_timeout_s: Positive[Duration] = 5.0
    handshake_timeout_s: Positive[Duration] = 120.0
    external_timeout_s: Positive[Duration] = 60.0
    clock: Flag = True
    real_time_factor: Positive[Number] = 1.0
    served: Flag = False
    latency: str = NONE
    open_loop: Flag = False
    progress: Literal["bar", "lines", "none"] = "bar"
    vehicle: Any = field(default_factory=VehicleOptions)
    stage_parameters: str = ""

    @model_validator(mode="after")
    def _check(self) -> BridgeOptions:
        try:
            VehicleModel.of(self._own_vehicle)
        except ValueError as error:
            raise ValueError(f"vehicle.{error}") from error
        _by_stage(self.stage_parameters)
        latency_steps(self.latency)
        return self

    @property
    def _own_vehicle(self) -> dict[str, float]:
        return {name: value for name, value in asdict(self.vehicle).items() if value != OF_THE_SCENARIO}

    def plan(self, scenario: Scenario | None = None) -> RunPlan:
        """Returns the run, as a new execution; raises InputError if its scenario cannot be used.

        `scenario` is that of these parameters, if it is loaded already.
        """
        chosen = {"ego": self.ego_id} | {name: getattr(self, name) for name in ("seed", "draw", "end_after_contact_s")}
        overrides: dict[str, Any] = {name: value for name, value in chosen.items() if value != OF_THE_SCENARIO}
        scenario = scenario or Scenario.load(self.scenario, **overrides, vehicle=self._own_vehicle or None)
        stages = without_latency(_by_stage(self.stage_parameters))
        later = {} if latency_steps(self.latency) == 0 else {BRIDGE: {LATENCY: latency_text(self.latency)}}
        return RunPlan(scenario, self.ego, self.policy, stages | later, new_execution())


def _by_stage(text: str) -> Parameters:
    """Parse parameters by stage and name from YAML (the launcher sends JSON); raises ValueError if it holds others."""
    try:
        parameters = load_yaml(text) or {}
    except yaml.YAMLError:
        parameters = None
    if not isinstance(parameters, dict) or not all(isinstance(values, dict) for values in parameters.values()):
        raise ValueError(f"stage_parameters is {text!r}, expected such as {{conflict: {{horizon: 2.0}}}}")
    return parameters


def bridge_stage(read: ParameterOverrides) -> BridgeOptions:
    """Read the parameters of the bridge."""
    return read(BridgeOptions())


@configuration
class RecorderOptions:
    """What the recorder records of a run, and where.

    Attributes:
        output: folder of the recording.
        overwrite: whether an existing recording is replaced.
        topics: names of topics of the ego's stack to be recorded as well, separated by spaces.
    """

    output: str = "bags/run"
    overwrite: Flag = False
    topics: str = ""


def recorder_stage(read: ParameterOverrides) -> RecorderOptions:
    """Read the parameters of the recorder."""
    return read(RecorderOptions())
