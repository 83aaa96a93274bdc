"""Tables as sources of recordings publish them."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

CURVE_S = 12.0  # [s] of each track


@pytest.fixture(scope="session")
def traffic() -> Callable[..., pd.DataFrame]:
    """Five cars on a left-hand bend, in SI units and mathematical angles, at 25 Hz; by keyword, factors of columns."""

    def made(**factors: float) -> pd.DataFrame:
        t = np.arange(0.0, CURVE_S, 0.04)
        cars = []
        for number in range(1, 6):
            speed, radius = 6.0 + number, 80.0 + 4.0 * number
            angle = speed * t / radius
            cars.append(
                pd.DataFrame(
                    {
                        "track_id": number,
                        "timestamp": t,
                        "x": 100.0 + radius * np.sin(angle),
                        "y": 20.0 - radius * np.cos(angle),
                        "heading": angle,
                        "speed": speed,
                        "length": 4.4,
                        "width": 1.8,
                        "agent_type": "car",
                    }
                )
            )
        table = pd.concat(cars, ignore_index=True)
        for name, factor in factors.items():
            table[name] *= factor
        return table

    return made
