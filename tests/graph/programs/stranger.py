"""Somebody on the domain who knows LitSim's topics and means another run: at every step he says nonsense on each.

Numbers that are none, arrays that are empty or of unequal lengths, ids twice, and stamps of about now.
"""

import math
from typing import Any

import rclpy
from geometry_msgs.msg import Pose2D
from litsim_msgs.msg import AgentStates, Controls, EgoControl, JointForecast, StageStatus, Takeover, Takeovers
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from litsim_sim.core.stages import BRIDGE, EGO, RECORDER, StageState
from litsim_sim.launch.middleware import use_middleware_settings
from litsim_sim.ros import topics
from litsim_sim.ros.messages import header

NAN, OTHER = math.nan, "short-idm-litsim-13-0-another@1"
STEP_NS = 100_000_000


def nonsense(step: int, run_id: str) -> dict[topics.Topic, list[Any]]:
    """Messages by topic."""
    usual = {"header": header(step), "run_id": run_id, "step": step}
    lost = Takeover(agent=3, state=200, conflict_pose=Pose2D(x=NAN), reference_path=[NAN] * 3)
    told = [
        StageStatus(**usual, stage=stage, state=state, compute_time=NAN, text="nonsense")
        for stage, state in ((BRIDGE, StageState.FAILED), (RECORDER, StageState.FINISHED), (EGO, StageState.READY))
    ]
    return {
        topics.AGENTS: [
            AgentStates(**usual),
            AgentStates(**usual, total_steps=3, ego_id=1, id=[5, 5], x=[NAN], speed=[math.inf] * 7, kind=[9]),
        ],
        topics.FORECASTS: [
            JointForecast(**usual),
            JointForecast(**usual, dt=NAN, horizon=-1.0, id=[2, 1], mean=[NAN] * 3, valid=[True]),
        ],
        topics.TAKEOVERS: [Takeovers(**usual), Takeovers(**usual, takeovers=[lost, lost])],
        topics.CONTROLS: [Controls(**usual), Controls(**usual, id=[12, 12], acceleration=[NAN], source=[77] * 3)],
        topics.EGO_CONTROL: [EgoControl(**usual, mode=99), EgoControl(**usual, acceleration=NAN, yaw_rate=math.inf)],
        topics.STATUS: told,
        topics.RECORDED: told,
        topics.TIMING: told,
    }


class Stranger(Node):
    def __init__(self) -> None:
        super().__init__("stranger")
        self.to = {topic: self.create_publisher(topic.type, topic.name, topic.qos) for topic in nonsense(0, "")}
        self.step = -1
        self.create_subscription(Clock, topics.CLOCK.name, self.on_clock, topics.CLOCK.qos)
        self.create_timer(0.5, self.speak)

    def on_clock(self, clock: Clock) -> None:
        self.step = (clock.clock.sec * 10**9 + clock.clock.nanosec) // STEP_NS
        print(f"step {self.step}", flush=True)
        self.speak()

    def speak(self) -> None:
        step = max(self.step, 0)
        for of, run_id in ((step, ""), (step, OTHER), (step + 1, OTHER)):
            for topic, messages in nonsense(of, run_id).items():
                for message in messages:
                    self.to[topic].publish(message)


def main() -> None:
    use_middleware_settings("stranger")
    rclpy.init()
    rclpy.spin(Stranger())


if __name__ == "__main__":
    main()
