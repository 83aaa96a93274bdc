"""What a kind of Autoware expects: its topics, services, and what has to be called before it drives."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict

from litsim_sim.io.yaml_input import read_yaml

PACKAGED = Path(__file__).parents[1] / "profiles"
CONTROL: Final = "control"
TRAJECTORY: Final = "trajectory"


class Profile(BaseModel):
    """Names of topics and services; null where the stack has none.

    Attributes:
        description: kind of stack.
        answers: whether the ego follows the stack's control commands or its trajectory.
        starts_in: control mode of the vehicle at the start: autonomous, or manual until the stack requests another.
        objects, tracked_objects: for other agents, as predicted or tracked objects.
        traffic_signals: for what traffic signals show.
        obstacle_cloud: for an empty cloud, which says that there is nothing but the objects.
        control, trajectory: of the stack, one of which the ego follows.
        initialization_state, operation_mode: topics on which the adapter speaks for the stack: that it is localised,
            and that it drives.
        mrm_state: of the stack, the state of its minimum-risk manoeuvre.
        initialize, clear_route, set_route, engage: services of the stack that are called, in this order, before it
            drives; a route is cleared if one is set already.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    description: str
    answers: Literal["control", "trajectory"] = CONTROL
    starts_in: Literal["autonomous", "manual"]
    objects: str | None
    tracked_objects: str | None
    traffic_signals: str | None
    obstacle_cloud: str | None
    control: str
    trajectory: str
    initialization_state: str | None
    operation_mode: str | None
    mrm_state: str | None
    initialize: str | None
    clear_route: str | None
    set_route: str | None
    engage: str | None

    @classmethod
    def load(cls, name: str) -> Profile:
        """The packaged profile of a name, or that in a YAML file.

        Raises:
            InputError: there is none, or some of its fields do not fit.
        """
        packaged = PACKAGED / f"{name}.yaml"
        return read_yaml(packaged if packaged.is_file() else Path(name), cls)


def packaged_profiles() -> tuple[str, ...]:
    """Names of the packaged profiles."""
    return tuple(sorted(path.stem for path in PACKAGED.glob("*.yaml")))
