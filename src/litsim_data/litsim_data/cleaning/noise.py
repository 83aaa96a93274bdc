"""Noise of recorded motion: whether it has to be cleaned before vehicles can be expected to drive on from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from litsim_data.cleaning.report import overlaps, share

HARSH = 5.0  # [m/s2] magnitude that accelerations of vehicles hardly ever exceed
HARSH_SHARE = 0.05  # share of harsh accelerations from which motion is noisy. Untuned
ASIDE = 0.15  # [m] distance of a position from the middle of those before and after: an acceleration of 30 m/s2
ASIDE_SHARE = 0.01  # likewise of positions that jitter. Untuned


@dataclass(frozen=True)
class Noise:
    """Noise of the motion of vehicles.

    Attributes:
        harsh: share of accelerations beyond HARSH.
        aside: share of positions more than ASIDE from the middle of those before and after.
        overlaps: number of pairs of vehicles whose boxes overlap at some time.
    """

    harsh: float
    aside: float
    overlaps: int

    @classmethod
    def of(cls, table: pd.DataFrame) -> Noise:
        """Returns the noise of vehicles of a recording's `table`, sorted by vehicle and frame, of 10 Hz."""
        vehicle, place = table["vehicle_id"].to_numpy(), table[["x", "y"]].to_numpy(np.float64)
        within = vehicle[2:] == vehicle[:-2]
        bend = np.linalg.norm(place[2:] - 2.0 * place[1:-1] + place[:-2], axis=1)[within]
        return cls(
            harsh=share(table["acceleration"].to_numpy(np.float64), HARSH),
            aside=share(0.5 * bend, ASIDE),
            overlaps=len(overlaps(table)),
        )

    @property
    def needs_cleaning(self) -> bool:
        """Whether accelerations or positions are too noisy; boxes that overlap alone are not helped by cleaning."""
        return self.harsh > HARSH_SHARE or self.aside > ASIDE_SHARE

    def described(self, cleaned: Noise, moved: float) -> str:
        """Returns a line on what cleaning has changed, if positions were `moved` by that much in the median [m]."""
        return (
            f"accelerations beyond {HARSH:g} m/s2 {self.harsh:.1%} -> {cleaned.harsh:.1%}, positions more than "
            f"{ASIDE:g} m off their course {self.aside:.1%} -> {cleaned.aside:.1%}, pairs of boxes that overlap "
            f"{self.overlaps} -> {cleaned.overlaps}; moved by {moved:.2f} m (median); --raw keeps the motion"
        )
