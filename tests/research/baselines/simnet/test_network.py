"""SimNet's networks in the loop: what torch says, row by row; and what is said of files that are something else."""

from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from litsim_research.baselines.simnet.network import GraphNetwork, SmallNetwork, load_network, shapes
from litsim_research.baselines.simnet.output import FORMAT, OUTPUTS
from litsim_research.baselines.simnet.plugin import SHIPPED
from litsim_research.baselines.simnet.raster import CHANNELS, PAPER, SMALL, RasterShape
from litsim_sim.core.errors import InputError

torch = pytest.importorskip("torch", reason="torch is for training: make setup-all installs it")


def rasters(shape: RasterShape, count: int) -> np.ndarray:
    random = np.random.default_rng(3)
    return random.uniform(-1.0, 1.0, (count, CHANNELS, shape.rows, shape.columns)).astype(np.float32)


@pytest.mark.parametrize(
    ("backbone", "shape", "kind"), [("small", SMALL, SmallNetwork), ("resnet50", PAPER, GraphNetwork)]
)
def test_the_loop_says_what_torch_says_whoever_is_beside(
    tmp_path: Path, backbone: str, shape: RasterShape, kind: type
) -> None:
    from litsim_research.imitation.simnet_network import SimNet, ending, save

    torch.manual_seed(0)
    trained = SimNet(backbone).eval()  # type: ignore[arg-type]
    trained.scale_to(np.random.default_rng(1).normal(2.0, np.arange(1, OUTPUTS + 1), (50, OUTPUTS)), np.ones(OUTPUTS))
    path = tmp_path / f"some{ending(backbone)}"  # type: ignore[arg-type]
    save(trained, path, {"seed": "0"})
    network = load_network(path)
    assert isinstance(network, kind) and network.shape == shape
    given = rasters(shape, 3)
    said = network(given)
    with torch.no_grad():
        expected = trained.physical(torch.from_numpy(given)).numpy()
    near = 1e-4 * float(np.abs(expected).max())
    assert said == pytest.approx(expected, abs=near)
    assert np.abs(said[0] - said[1]).max() > near  # the raster matters
    for row in (2, 0):
        assert np.array_equal(network(given[row : row + 1])[0], said[row])
    assert network(given[:0]).shape == (0, OUTPUTS)


def test_the_weights_that_come_with_litsim_are_of_the_small_backbone() -> None:
    assert isinstance(load_network(SHIPPED), SmallNetwork)
    assert SHIPPED.stat().st_size < 5e6


def test_files_that_are_something_else(tmp_path: Path) -> None:
    arrays = load_file(SHIPPED)
    told = {"format": FORMAT}

    def written(name: str, content: dict[str, np.ndarray], metadata: dict[str, str]) -> Path:
        save_file(content, tmp_path / name, metadata)
        return tmp_path / name

    cases = {
        "no such weights": tmp_path / "missing.safetensors",
        "not a readable safetensors file": tmp_path / "text.safetensors",
        "metadata format is 'other'": written("other.safetensors", arrays, {"format": "other"}),
        "tensor last.bias is none": written(
            "less.safetensors", {k: v for k, v in arrays.items() if k != "last.bias"}, told
        ),
        r"tensor hidden.bias is float32 \(7,\), expected": written(
            "shape.safetensors", arrays | {"hidden.bias": np.zeros(7, np.float32)}, told
        ),
        "tensor last.bias holds non-finite": written(
            "nan.safetensors", arrays | {"last.bias": np.full(OUTPUTS, np.nan, np.float32)}, told
        ),
        "ONNX Runtime refuses it": tmp_path / "text.onnx",
    }
    (tmp_path / "text.safetensors").write_text("nothing")
    (tmp_path / "text.onnx").write_text("nothing")
    for said, path in cases.items():
        with pytest.raises(InputError, match=said) as error:
            load_network(path)
        assert str(path) in str(error.value)
    assert set(shapes()) == set(arrays)


def test_a_graph_of_something_else(tmp_path: Path) -> None:
    from litsim_predictor.inference import GRAPHS
    from litsim_predictor.inference.weights import packaged

    other = tmp_path / "other.onnx"
    other.write_bytes((packaged("graphs") / f"{GRAPHS[0]}.onnx").read_bytes())
    with pytest.raises(InputError, match=r"other.onnx: "):
        load_network(other)


@pytest.mark.parametrize(("rows", "outputs"), [(8, OUTPUTS), (PAPER.rows, 1)])
def test_a_graph_of_other_shapes_is_refused(tmp_path: Path, rows: int, outputs: int) -> None:
    """One output would otherwise be taken for all of them."""
    from onnx import TensorProto, helper, save

    shapes = {"raster": [1, CHANNELS, rows, PAPER.columns], "future": [1, outputs]}
    raster, future = (helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items())
    said = helper.make_tensor("said", TensorProto.FLOAT, [1, outputs], [0.0] * outputs)
    graph = helper.make_graph([helper.make_node("Constant", [], ["future"], value=said)], "g", [raster], [future])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"format": FORMAT})
    path = tmp_path / "other.onnx"
    save(model, path)
    with pytest.raises(InputError, match=r"other\.onnx: inputs and outputs are .*, expected \[\('raster', "):
        load_network(path)
