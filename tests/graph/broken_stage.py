"""A conflict stage that is ready, and fails at step 5."""

from __future__ import annotations

from typing import Any

from litsim_msgs.msg import AgentStates, JointForecast, RunInfo, Takeovers

from litsim_sim.ros.messages import header
from litsim_sim.ros.stage import StageNode, run_stages
from litsim_sim.ros.topics import AGENTS, FORECASTS, TAKEOVERS
from litsim_sim.scenario.scenario import Scenario


def itself(message: Any) -> Any:
    return message


def as_it_is(message: Any, run_id: str) -> Any:
    del run_id
    return message


class BrokenStage(StageNode):
    stage = "conflict"
    inputs = ((AGENTS, itself), (FORECASTS, itself))
    output = (TAKEOVERS, as_it_is)

    def configure(self, info: RunInfo, scenario: Scenario) -> str:
        return info.run_id

    def answer(self, core: str, agents: AgentStates, forecast: JointForecast) -> Takeovers:
        step = agents.step
        return Takeovers(header=header(step), run_id=core, step=step * (5 - step) // (5 - step))


if __name__ == "__main__":
    run_stages(BrokenStage)
