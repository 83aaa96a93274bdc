"""The split of encounters by vehicle: what is fitted to people's reactions has seen no vehicle that is reported on."""

from __future__ import annotations

import hashlib

from litsim_sim.scenario.encounter_note import Split

REPORTED_SHARE = 0.4  # of the vehicles
WINDOWS_SITES = ("us101", "us101_0750")  # the latter is the name of recordings of the windows file
WINDOWS_LAST_ID = 720  # in the first period of US-101: vehicles of the windows file, and of windows held out before
UNKNOWN_IDS_FROM = 100_001  # ids that the windows file gives to vehicles whose NGSIM id is not known


def split_of(site: str, period: int, vehicle: int) -> Split:
    """Returns the part of the vehicle that reacts, the same in every file of a site.

    Vehicles of the US-101 windows are always reported on: other results come from runs of these windows.
    """
    in_windows = vehicle <= WINDOWS_LAST_ID or vehicle >= UNKNOWN_IDS_FROM
    if site in WINDOWS_SITES and period == 0 and in_windows:
        return "reported"
    digest = hashlib.sha256(f"{site}/{period}/{vehicle}".encode()).hexdigest()
    return "reported" if int(digest[:8], 16) / 2**32 < REPORTED_SHARE else "tuning"
