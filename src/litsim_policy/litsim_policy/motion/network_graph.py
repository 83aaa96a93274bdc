"""Networks that were trained by other libraries: ONNX files with one input and one output, run by ONNX Runtime."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from litsim_predictor.inference.compiled import BROKEN, first_line, open_graph
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.input_files import require_file


class NetworkGraph:
    """A network from observations to actions; equal observations give equal bits in every process.

    Args:
        path: of the file.
        observed: features of an observation.
        actions: parts of an action.

    Raises:
        InputError: the file is missing or damaged, or its network is not one of float32 (1, observed) to (1, actions).
    """

    def __init__(self, path: Path, observed: int, actions: int) -> None:
        require_file(path, "network")
        self._path, self._actions, self._session = path, actions, open_graph(path, {})
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        if len(inputs) != 1 or len(outputs) != 1:
            raise InputError(f"{path}: {len(inputs)} inputs and {len(outputs)} outputs, expected one of each")
        self._input = inputs[0].name
        try:
            answer = self._answer(np.zeros(observed, np.float32))
        except BROKEN as error:
            expected = f"expected float32 of shape (1, {observed})"
            raise InputError(f"{path}: input {self._input} is refused: {first_line(error)}; {expected}") from error
        if answer.shape != (1, actions):
            raise InputError(f"{path}: output has shape {answer.shape}, expected (1, {actions})")

    def actions(self, observations: FloatArray) -> FloatArray:
        """Returns actions (m, actions), clipped to [-1, 1], for observations (m, observed).

        Raises:
            InputError: the network answers with a number that is not finite.
        """
        # row by row: the blocking of a matrix product must not let agents change each other's last bits
        rows = [self._answer(row).astype(np.float64) for row in observations.astype(np.float32)]
        actions = np.clip(np.concatenate([np.empty((0, self._actions)), *rows]), -1.0, 1.0)
        if not np.isfinite(actions).all():
            raise InputError(f"{self._path}: an action is not finite, expected numbers from -1 to 1")
        return actions

    def _answer(self, observation: np.ndarray) -> np.ndarray:
        """Returns the output for an observation (observed,)."""
        answer: np.ndarray = self._session.run(None, {self._input: observation[None]})[0]
        return answer
