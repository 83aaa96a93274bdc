"""What is around the ego as Autoware reads it: other agents with their forecasts, and what signals show."""

from __future__ import annotations

from collections import deque
from functools import partial

import numpy as np
from autoware_perception_msgs.msg import PredictedObjects, TrackedObjects, TrafficLightGroupArray
from litsim_msgs.msg import JointForecast, SignalStates
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2

from litsim_autoware.messages import objects
from litsim_autoware.messages.cdr import ENCAPSULATION, stamped
from litsim_autoware.messages.objects import Forecast
from litsim_autoware.messages.output import Output
from litsim_autoware.node.announced_run import AnnouncedRun
from litsim_autoware.node.clock import CLOCK_MESSAGE
from litsim_autoware.stack.profile import Profile
from litsim_sim.core.scene import AgentTable
from litsim_sim.ros.topics import FORECASTS, SIGNALS


class Surroundings:
    """Publishes all agents but the ego, what signals show, and that there is nothing else.

    Attributes:
        signals: what they have shown last.
        forecasts: the newest two.
    """

    def __init__(self, node: Node, profile: Profile) -> None:
        self._predicted = Output(node, PredictedObjects, profile.objects)
        self._predicts = profile.objects is not None
        self._tracked = Output(node, TrackedObjects, profile.tracked_objects)
        self._lights = Output(node, TrafficLightGroupArray, profile.traffic_signals)
        self._cloud = Output(node, PointCloud2, profile.obstacle_cloud)
        empty = PointCloud2(height=1, is_dense=True, point_step=16)
        empty.header.frame_id = "base_link"
        self._empty_cloud = serialize_message(empty)[len(ENCAPSULATION) + 8 :]
        self.signals: SignalStates | None = None
        self.forecasts: deque[Forecast] = deque(maxlen=2)

    def begin_run(self, run: AnnouncedRun) -> None:
        """Take the lights of a run, and whether it has signals and forecasts that are read."""
        self._light_ids, self._light_groups = objects.lights_of(run.scenario.signals)
        self._with_signals = SIGNALS.name in run.topics
        self.with_forecasts = FORECASTS.name in run.topics and self._predicts

    def is_complete(self, step: int, *, with_forecast: bool) -> bool:
        """Returns whether all of a step has come: what signals show, and, if `with_forecast`, the forecast.

        The paths of objects are of the forecast of the step before: that of a step comes while the stack answers it.
        """
        if self._with_signals and (self.signals is None or self.signals.step != step):
            return False
        newest = self.forecasts[-1].step if self.forecasts else -1
        return newest >= step - 1 or not (self.with_forecasts and with_forecast)

    def show(self, others: AgentTable, stamp_ns: int) -> None:
        """Publish the agents but the ego, the lights, and an empty cloud, with a stamp of the stack's time [ns]."""
        newest = next((past for past in reversed(self.forecasts) if past.step < others.step), None)
        self._predicted.publish(partial(objects.predicted_objects, others, stamp_ns, newest))
        self._tracked.publish(partial(objects.tracked_objects, others, stamp_ns))
        if self.signals is not None:
            states = np.frombuffer(self.signals.state, np.uint8)[self._light_groups]
            self._lights.publish(partial(objects.traffic_lights, self._light_ids, states, stamp_ns))
        self._cloud.publish(lambda: CLOCK_MESSAGE.data(stamped(stamp_ns)) + self._empty_cloud)


def forecast_of(message: JointForecast) -> Forecast:
    """The forecast of a message, of the most probable manoeuvre of each agent."""
    agents = len(message.id)
    probability = np.asarray(message.maneuver_probability, np.float64).reshape(agents, -1 if agents else 0)
    return Forecast(
        step=message.step,
        dt=message.dt,
        id=np.asarray(message.id, np.int64),
        mean=np.asarray(message.mean).reshape(agents, -1 if agents else 0, 2),
        yaw=np.asarray(message.yaw).reshape(agents, -1 if agents else 0),
        probability=probability.max(axis=1, initial=0.0) if probability.shape[1] else np.ones(agents),
        valid=np.array(message.valid, np.bool_),
    )
