"""The recorder, but for one message that does not reach it: the ego's state at step 7."""

from litsim_sim.nodes import recorder
from litsim_sim.ros.topics import EGO_STATE, Topic


class DeafRecorder(recorder.RecorderNode):
    def _take(self, topic: Topic, data: bytes) -> None:
        if topic != EGO_STATE or recorder.step_of(topic, data) != 7:
            super()._take(topic, data)


if __name__ == "__main__":
    recorder.RecorderNode = DeafRecorder
    recorder.main()
