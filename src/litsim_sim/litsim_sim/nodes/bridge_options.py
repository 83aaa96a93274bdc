"""The parameters of the bridge: the run, and how to run it."""

from __future__ import annotations

from dataclasses import asdict, field, make_dataclass
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, model_validator

from litsim_sim.core.parameters import ParameterReader, Parameters
from litsim_sim.core.quantities import Duration, Number, OneOf, Positive, Unit, Whole, configuration, field_type, unit
from litsim_sim.core.vehicle import VEHICLE_FIELDS, VehicleModel
from litsim_sim.ego_port.answer import INTERFACES
from litsim_sim.scenario.run_info import EGOS, POLICIES, RunPlan, new_execution
from litsim_sim.scenario.scenario import Scenario

OF_THE_SCENARIO = -1
"""Value of a parameter that leaves it to the scenario."""

_TYPES = {name: Annotated[Number, Unit(unit(field_type(VehicleModel, name)))] for name in VEHICLE_FIELDS}
VehicleOptions: Any = configuration(
    make_dataclass(
        "VehicleOptions", [(name, kind, float(OF_THE_SCENARIO)) for name, kind in _TYPES.items()], frozen=True
    )
)
"""The fields of :class:`litsim_sim.core.vehicle.VehicleModel`, each with the value that leaves it to the scenario."""


@configuration
class BridgeOptions:
    """Parameters of the bridge.

    Attributes:
        scenario: packaged scenario, or a YAML file.
        ego: what drives the ego.
        policy: what moves the background.
        ego_id: vehicle of the recording that is the ego.
        seed: of everything random in the run.
        end_after_contact_s: time after the ego's first contact at which the run is over.
        mode: whether the bridge waits for answers, or keeps pace with the clock.
        on_missing: what happens in lock-step where an answer does not come.
        on_invalid: what happens where an answer of the ego cannot be used.
        ego_interface: with what an external ego answers; auto is the interface of its first message.
        answer_timeout_s: for the answers to one step.
        handshake_timeout_s: for every stage to get ready; on a busy machine that takes its time, and the stages waited
            for are reported every few seconds.
        external_timeout_s: for an external ego to answer step 0.
        progress: how the progress of the run is shown.
        vehicle: of the ego.
        stage_parameters: what the stages' parameters are set to, by stage and name, in YAML; part of the identity
            of the run, not set by it.
    """

    scenario: str = "demo"
    ego: Annotated[str, OneOf(EGOS)] = "idm"
    policy: Annotated[str, OneOf(POLICIES)] = "litsim"
    ego_id: Annotated[Whole, Field(ge=OF_THE_SCENARIO)] = OF_THE_SCENARIO
    seed: Annotated[Whole, Field(ge=OF_THE_SCENARIO)] = OF_THE_SCENARIO
    end_after_contact_s: Annotated[Duration, Field(ge=OF_THE_SCENARIO)] = float(OF_THE_SCENARIO)
    mode: Literal["lockstep", "realtime"] = "lockstep"
    on_missing: Literal["stop", "hold"] = "stop"
    on_invalid: Literal["stop", "hold"] = "stop"
    ego_interface: Annotated[str, OneOf(INTERFACES)] = INTERFACES[0]
    answer_timeout_s: Positive[Duration] = 5.0
    handshake_timeout_s: Positive[Duration] = 120.0
    external_timeout_s: Positive[Duration] = 60.0
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
        return self

    @property
    def _own_vehicle(self) -> dict[str, float]:
        return {name: value for name, value in asdict(self.vehicle).items() if value != OF_THE_SCENARIO}

    def plan(self) -> RunPlan:
        """Load the run, as an execution of its own.

        Raises:
            InputError: the scenario cannot be used, or not with these options.
        """
        chosen = {"ego": self.ego_id, "seed": self.seed, "end_after_contact_s": self.end_after_contact_s}
        overrides: dict[str, Any] = {name: value for name, value in chosen.items() if value != OF_THE_SCENARIO}
        scenario = Scenario.load(self.scenario, **overrides, vehicle=self._own_vehicle or None)
        return RunPlan(scenario, self.ego, self.policy, _by_stage(self.stage_parameters), new_execution())


def _by_stage(text: str) -> Parameters:
    """Parameters by stage and name, as they come in a text: the launcher's is JSON.

    Raises:
        ValueError: the text holds something else.
    """
    try:
        found = yaml.safe_load(text) or {}
    except yaml.YAMLError:
        found = None
    if not isinstance(found, dict) or not all(isinstance(values, dict) for values in found.values()):
        raise ValueError(f"stage_parameters is {text!r}, expected such as {{conflict: {{horizon: 2.0}}}}")
    return found


def bridge_stage(read: ParameterReader) -> BridgeOptions:
    """Read the parameters of the bridge."""
    return read(BridgeOptions())
