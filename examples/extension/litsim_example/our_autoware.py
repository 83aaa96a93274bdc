"""The adapter `our_autoware`: Autoware with a profile of one's own, and a further topic on the record."""

from __future__ import annotations

from litsim_sim.launch.adapters import EgoAdapter

OUR_AUTOWARE = EgoAdapter(
    package="litsim_autoware",
    executable="autoware",
    arguments=("--profile", "our_profile.yaml"),
    record=("/planning/trajectory",),
    ready_s=120.0,
)
