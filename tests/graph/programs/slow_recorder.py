"""The recorder, on a disk that hangs: what is to be written at step 5 takes until a file is there."""

import sys
import time
from pathlib import Path

from litsim_sim.nodes import recorder

GO = Path(sys.argv.pop(1))


class SlowRecorder(recorder.RecorderNode):
    def _write(self, name: str, data: bytes, step: int) -> None:
        while step == 5 and not GO.exists():
            time.sleep(0.02)
        super()._write(name, data, step)


if __name__ == "__main__":
    recorder.RecorderNode = SlowRecorder
    recorder.main()
