"""An ego that is ready, and fails at step 5."""

from typing import Any

from litsim_policy.ego.node import EgoNode
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.ros.stage import run_stages


class BrokenEgo(EgoNode):
    def answer(self, core: Any, agents: AgentTable) -> EgoCommand:
        return EgoCommand(agents.step * (5 - agents.step) // (5 - agents.step))


if __name__ == "__main__":
    run_stages(BrokenEgo)
