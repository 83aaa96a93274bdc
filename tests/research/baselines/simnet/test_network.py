"""SimNet's networks in the loop: what torch says, row by row; and what is said of files that are something else."""

from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from litsim_research.baselines.simnet.network import load_network, shapes
from litsim_research.baselines.simnet.output import FORMAT, OUTPUTS
from litsim_research.baselines.simnet.plugin import SHIPPED
from litsim_research.baselines.simnet.raster import CHANNELS, SMALL
from litsim_sim.core.errors import InputError

torch = pytest.importorskip("torch", reason="torch is for training: make setup-all installs it")


def rasters(count: int) -> np.ndarray:
    random = np.random.default_rng(3)
    return random.uniform(-1.0, 1.0, (count, CHANNELS, SMALL.rows, SMALL.columns)).astype(np.float32)


def test_the_loop_says_what_torch_says_whoever_is_beside(tmp_path: Path) -> None:
    from litsim_research.imitation.simnet_network import SimNet, save

    torch.manual_seed(0)
    trained = SimNet().eval()
    trained.scale_to(np.random.default_rng(1).normal(2.0, np.arange(1, OUTPUTS + 1), (50, OUTPUTS)), np.ones(OUTPUTS))
    path = tmp_path / "some.safetensors"
    save(trained, path, {"seed": "0"})
    network = load_network(path)
    given = rasters(3)
    said = network(given)
    with torch.no_grad():
        expected = trained.physical(torch.from_numpy(given)).numpy()
    near = 1e-4 * float(np.abs(expected).max())
    assert said == pytest.approx(expected, abs=near)
    assert np.abs(said[0] - said[1]).max() > near  # the raster matters
    for row in (2, 0):
        assert np.array_equal(network(given[row : row + 1])[0], said[row])
    assert network(given[:0]).shape == (0, OUTPUTS)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"last.bias": None}, "tensor last.bias is none"),
        ({"hidden.bias": np.zeros(7, np.float32)}, r"tensor hidden.bias is float32 \(7,\), expected"),
        ({"last.bias": np.full(OUTPUTS, np.nan, np.float32)}, "tensor last.bias holds non-finite"),
    ],
)
def test_files_that_are_something_else(changed: dict[str, np.ndarray | None], said: str, tmp_path: Path) -> None:
    arrays, path = load_file(SHIPPED), tmp_path / "some.safetensors"
    assert set(shapes()) == set(arrays)
    save_file({k: v for k, v in (arrays | changed).items() if v is not None}, path, {"format": FORMAT})
    with pytest.raises(InputError, match=rf"some\.safetensors: {said}"):
        load_network(path)
    save_file(arrays, path, {"format": "other"})
    with pytest.raises(InputError, match="metadata format is 'other'"):
        load_network(path)
