"""A stack that drives at constant speed, and at step 8 tries to have its run end, or be recorded, as something else."""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import TwistStamped
from litsim_msgs.msg import RunInfo, StageStatus
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from litsim_sim.core.stages import BRIDGE, RECORDER, StageState
from litsim_sim.ros import topics

AT = 8
VISIT_S = 0.05
way, bag = sys.argv[1], Path(sys.argv[2])
rclpy.init()
node = rclpy.create_node("cheat")
answers = node.create_publisher(TwistStamped, "/litsim/ego/twist", 10)
run: dict[str, Any] = {"id": "", "cheated": False}


def say(*messages: tuple[topics.Topic, Any]) -> None:
    """Publishes on topics of the graph's own, and is gone again."""
    publishers = {topic: node.create_publisher(topic.type, topic.name, topic.qos) for topic, _ in messages}
    end = time.monotonic() + 1.0
    while not all(each.get_subscription_count() for each in publishers.values()) and time.monotonic() < end:
        time.sleep(0.005)
    for topic, message in messages:
        publishers[topic].publish(message)
    time.sleep(VISIT_S)
    for publisher in publishers.values():
        node.destroy_publisher(publisher)


def status(stage: str, state: StageState, step: int) -> StageStatus:
    return StageStatus(run_id=run["id"], stage=stage, state=state, step=step, text="ended: {reason: net_end}")


def publish(topic: topics.Topic, **fields: Any) -> Callable[[], None]:
    return lambda: say((topic, topic.type(run_id=run["id"], step=AT, **fields)))


def forge_end() -> None:
    forge_measures()
    finished = [(topics.STATUS, status(BRIDGE, state, AT)) for state in (StageState.RUNNING, StageState.FINISHED)]
    say((topics.RECORDED, status(RECORDER, StageState.RUNNING, 10**6)), *finished)


def set_parameters() -> None:
    """Asks every node to become another one."""
    for name in ("bridge", "recorder", "stages"):
        client = node.create_client(SetParameters, f"/litsim/{name}/set_parameters")
        if client.wait_for_service(timeout_sec=1.0):
            values = [Parameter(key, value=value).to_parameter_msg() for key, value in (("seed", 5), ("ego", "idm"))]
            client.call_async(SetParameters.Request(parameters=values))


def write_into_record() -> None:
    file = next(bag.glob("*.mcap")).open("r+b")
    file.seek(2000)
    file.write(bytes(2000))
    file.close()


def forge_measures() -> None:
    (bag / "metrics.json").write_text('{"valid": true}')


def edit_once_sealed() -> None:
    """Leaves a process behind, in a session of its own, that waits for the seal."""
    if os.fork():
        return
    os.setsid()
    if os.fork():
        os._exit(0)
    end = time.monotonic() + 60.0
    while not (bag / "seal.json").exists() and time.monotonic() < end:
        time.sleep(0.002)
    write_into_record()
    os._exit(0)


WAYS: dict[str, Callable[[], object]] = {
    "end": forge_end,
    "agents": publish(topics.AGENTS),
    "controls": publish(topics.CONTROLS),
    "run_info": lambda: say((topics.RUN_INFO, RunInfo(run_id=run["id"], scenario="another", total_steps=AT + 1))),
    "record": write_into_record,
    "nothing": lambda: None,
    "elsewhere": lambda: [act() for act in (set_parameters, forge_measures, edit_once_sealed)],
}


def on_state(state: Odometry) -> None:
    step = round(state.header.stamp.sec * 10 + state.header.stamp.nanosec / 1e8)
    if step >= AT and not run["cheated"]:
        run["cheated"] = True
        WAYS[way]()
    answer = TwistStamped(header=state.header)
    answer.header.frame_id = "base_link"
    answer.twist.linear.x = state.twist.twist.linear.x
    answers.publish(answer)


node.create_subscription(RunInfo, topics.RUN_INFO.name, lambda info: run.update(id=info.run_id), topics.RUN_INFO.qos)
node.create_subscription(Odometry, "/litsim/ego/state", on_state, 100)
rclpy.spin(node)
