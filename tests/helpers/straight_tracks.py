"""Training and evaluation need torch, which `make setup` leaves out where asked to: LITSIM_TORCH=none."""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import pandas as pd
import pytest

HAS_TORCH = find_spec("torch") is not None
NEED_TORCH = ["learned", "cli/test_evaluate.py", "cli/test_export.py"]
if HAS_TORCH:
    import torch

    torch.set_num_threads(1)  # the scenes of tests are small
collect_ignore = [] if HAS_TORCH else NEED_TORCH


def pytest_report_header() -> list[str]:
    """What is left out, and why."""
    return [] if HAS_TORCH else [f"torch is not installed: left out are {', '.join(NEED_TORCH)}"]


def table(*vehicles: tuple[int, float, float, float], frames: int = 90, yaw: float = 0.0) -> pd.DataFrame:
    """Vehicles (id, x, y, speed) that drive straight on along `yaw`."""
    t = 0.1 * np.arange(frames)
    rows = [
        pd.DataFrame(
            {
                "vehicle_id": number,
                "frame": np.arange(frames),
                "x": x + speed * t * np.cos(yaw),
                "y": y + speed * t * np.sin(yaw),
                "yaw": yaw,
                "speed": speed,
                "length": 4.5,
                "width": 2.0,
            }
        )
        for number, x, y, speed in vehicles
    ]
    return pd.concat(rows, ignore_index=True)


@pytest.fixture(scope="session")
def straight() -> Callable[..., pd.DataFrame]:
    """See :func:`table`."""
    return table
