"""Latitudes and longitudes as metres: UTM from an origin, in which the nets of Lanelet2 maps with the same origin are.

The formulas are Krüger's series of the transverse Mercator projection, as in C. F. F. Karney, Transverse Mercator with
an accuracy of a few nanometers, Journal of Geodesy 85, 2011; its first four terms are exact to less than a millimetre
within a zone.
"""

from __future__ import annotations

import numpy as np

from litsim_sim.core.scene import FloatArray

RADIUS, FLATTENING = 6_378_137.0, 1.0 / 298.257223563  # [m] and 1 of WGS84
SCALE = 0.9996  # of UTM, along the central meridian
FALSE_EASTING, FALSE_NORTHING = 500_000.0, 10_000_000.0  # [m] of UTM; the latter south of the equator
ZONE = 6.0  # [deg] width of a zone
THIRD = FLATTENING / (2.0 - FLATTENING)
"""The third flattening n, in powers of which the series are."""
RECTIFYING = RADIUS / (1.0 + THIRD) * (1.0 + THIRD**2 / 4.0 + THIRD**4 / 64.0)  # [m]
TERMS = (
    THIRD / 2.0 - 2.0 * THIRD**2 / 3.0 + 5.0 * THIRD**3 / 16.0 + 41.0 * THIRD**4 / 180.0,
    13.0 * THIRD**2 / 48.0 - 3.0 * THIRD**3 / 5.0 + 557.0 * THIRD**4 / 1440.0,
    61.0 * THIRD**3 / 240.0 - 103.0 * THIRD**4 / 140.0,
    49_561.0 * THIRD**4 / 161_280.0,
)


def projected(
    latitude: FloatArray, longitude: FloatArray, origin: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Returns x to the grid's east and y to its north (n,) [m] of places (n,) [deg], from `origin` [deg] on.

    The origin's zone holds for all. Distances are those on the ground to within 0.04 %.
    """
    meridian = meridian_of(*origin)
    x, y = mercator(latitude, longitude, meridian)
    zero_x, zero_y = mercator(np.array(origin[0]), np.array(origin[1]), meridian)
    return x - zero_x, y - zero_y


def meridian_of(latitude: float, longitude: float) -> float:
    """Returns the central meridian [deg] of the zone in which a place [deg] is; zones of Norway are wider."""
    if 56.0 <= latitude < 64.0 and 3.0 <= longitude < 12.0:
        return 9.0
    if latitude >= 72.0 and 0.0 <= longitude < 42.0:  # Svalbard: zones meet at 9, 21 and 33 degrees
        return float(12.0 * np.floor((longitude + 3.0) / 12.0) + 3.0)
    return float(ZONE * np.floor(longitude / ZONE) + 0.5 * ZONE)


def utm(latitude: FloatArray, longitude: FloatArray, meridian: float) -> tuple[FloatArray, FloatArray]:
    """Returns UTM's easting and northing (n,) [m] of places (n,) [deg] on one side of the equator, in a zone."""
    x, y = mercator(latitude, longitude, meridian)
    return x + FALSE_EASTING, y + FALSE_NORTHING * (np.min(latitude) < 0.0)


def mercator(latitude: FloatArray, longitude: FloatArray, meridian: float) -> tuple[FloatArray, FloatArray]:
    """Returns metres east of a central `meridian` [deg], and north of the equator (n,), of places (n,) [deg]."""
    phi, lam = np.deg2rad(latitude), np.deg2rad(longitude - meridian)
    eccentricity = 2.0 * np.sqrt(THIRD) / (1.0 + THIRD)
    conformal = np.sinh(np.arctanh(np.sin(phi)) - eccentricity * np.arctanh(eccentricity * np.sin(phi)))
    xi = np.arctan2(conformal, np.cos(lam))
    eta = np.arcsinh(np.sin(lam) / np.hypot(conformal, np.cos(lam)))
    easting, northing = eta.copy(), xi.copy()
    for number, term in enumerate(TERMS, 1):
        easting += term * np.cos(2 * number * xi) * np.sinh(2 * number * eta)
        northing += term * np.sin(2 * number * xi) * np.cosh(2 * number * eta)
    return SCALE * RECTIFYING * easting, SCALE * RECTIFYING * northing
