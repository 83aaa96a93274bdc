"""Drivers that differ: what is drawn for each agent by the seed of its scene and its id."""

from __future__ import annotations

import math

import numpy as np

from litsim_sim.core.quantities import Acceleration, Duration, NonNegative, Number, Positive, configuration
from litsim_sim.core.scene import STEP_S, FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, kernel
from litsim_sim.scenario.setting import Setting


@configuration
class SpreadConfig:
    """How far drivers are from the median.

    That of headways is measured on recorded drivers by ``litsim_research train followers``; with this noise, drivers
    brake as differently as people in the tuning encounters of ``litsim_eval credibility``.

    Attributes:
        headway: standard deviation of the logarithm of the headway, by driver.
        noise: standard deviation of what is added to the acceleration behind others.
        noise_time: in which the correlation of that falls by e.
    """

    headway: NonNegative[Number] = 0.38
    noise: NonNegative[Acceleration] = 0.8
    noise_time: Positive[Duration] = 1.0


class DrawnDrivers:
    """The drivers of a scenario, each drawn when it is first asked for."""

    def __init__(self, scenario: Setting, config: SpreadConfig) -> None:
        self._ids, self._identities, self._steps = scenario.log.ids, scenario.identities, scenario.total_steps + 1
        self._config = config
        self._drawn: dict[int, tuple[float, FloatArray]] = {}

    def of(self, agents: IntArray, step: int) -> tuple[FloatArray, FloatArray]:
        """Returns factors (m,) on the headways of `agents` (m,), and accelerations (m,) [m/s2] to add at `step`."""
        drivers = [self._driver(row) for row in self._ids.searchsorted(agents).tolist()]
        return np.array([factor for factor, _ in drivers]), np.array([noise[step] for _, noise in drivers])

    def _driver(self, row: int) -> tuple[float, FloatArray]:
        """Returns the factor of the agent in `row` of the log, and its noise [m/s2] at each step."""
        if row not in self._drawn:
            config, random = self._config, np.random.default_rng(self._identities[row].tolist())
            factor = math.exp(config.headway * random.standard_normal())
            noise = config.noise * correlated(random.standard_normal(self._steps), STEP_S / config.noise_time)
            self._drawn[row] = factor, noise
        return self._drawn[row]


@kernel
def correlated(shocks: Floats, rate: float) -> Floats:
    """Noise (n,) of variance 1 from independent `shocks` (n,), whose correlation falls by e within 1 / `rate` steps."""
    noise, kept = shocks.copy(), math.exp(-rate)
    for k in range(1, len(noise)):
        noise[k] = kept * noise[k - 1] + math.sqrt(1.0 - kept * kept) * shocks[k]
    return noise
