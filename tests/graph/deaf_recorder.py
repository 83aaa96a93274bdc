"""The recorder, but for one message that does not reach it: the ego's state at step 7."""

from __future__ import annotations

from litsim_sim.nodes import recorder as recorder_node
from litsim_sim.ros.topics import EGO_STATE


class DeafRecorder(recorder_node.RecorderNode):
    def _take(self, name: str, data: bytes) -> None:
        if (name, recorder_node._step(data)) != (EGO_STATE.name, 7):
            super()._take(name, data)


if __name__ == "__main__":
    recorder_node.RecorderNode = DeafRecorder
    recorder_node.main()
