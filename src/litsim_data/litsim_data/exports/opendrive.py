"""Nets as OpenDRIVE, through netconvert."""

from __future__ import annotations

from pathlib import Path

from litsim_data.exports.export import Content, Export
from litsim_data.maps.netconvert import export_opendrive


class OpenDrive(Export):
    """The net of what is exported, in its frame."""

    endings, content = (".xodr",), "an OpenDRIVE map through netconvert"

    def write(self, content: Content, out: Path) -> list[str]:
        """See :class:`.export.Export`."""
        return [f"netconvert: {warning}" for warning in export_opendrive(content.net_file(), out)]
