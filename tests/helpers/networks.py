"""Small networks in ONNX files, as other libraries export them."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def exported(path: Path, observed: int, *actions: float, weight: float = 0.0) -> Path:
    """Writes a network of `observed` inputs with these outputs, plus `weight` times each input; returns `path`."""
    parts = {"weight": np.full((observed, len(actions)), weight), "bias": np.array(actions)}
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["seen", *parts], ["action"])],
        "network",
        [helper.make_tensor_value_info("seen", TensorProto.FLOAT, ["agents", observed])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["agents", len(actions)])],
        [numpy_helper.from_array(values.astype(np.float32), name) for name, values in parts.items()],
    )
    onnx.save(helper.make_model(graph, ir_version=10, opset_imports=[helper.make_opsetid("", 17)]), path)
    return path
