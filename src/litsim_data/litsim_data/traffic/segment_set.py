"""Sets of generated scenarios: recordings of a packaged net, cut into segments with a manifest."""

from __future__ import annotations

from pathlib import Path

from litsim_data import segments
from litsim_data.traffic.sites import SITES
from litsim_data.traffic.synthetic import synthesize_segments
from litsim_sim.core.errors import InputError


def write_segment_set(net: str, count: int, seed: int, folder: Path) -> segments.Manifest:
    """Writes recordings, manifest and scenario files for `count` segments on `net` to `folder`; returns the manifest.

    Raises:
        InputError: `net` is not one of ``SITES``, the seed gives no usable traffic, a segment has no possible ego, or
            `folder` cannot be written.
    """
    if net not in SITES:
        raise InputError(f"net is {net!r}, expected one of {', '.join(SITES)}")
    sources = []
    for number, recording in enumerate(synthesize_segments(SITES[net], count, seed)):
        name = f"{net}_{seed}_{number}.parquet"
        recording.write(folder / name)
        sources.append((name, net, None, recording))
    manifest = segments.cut(sources, segments.Settings(seed=seed))
    segments.write(manifest, folder)
    return manifest
