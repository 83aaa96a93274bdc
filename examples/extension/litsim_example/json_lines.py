"""The export `json_lines`: an object for each agent at each frame, one a line."""

from __future__ import annotations

from pathlib import Path

from litsim_data.exports.export import Content, Export
from litsim_sim.io.files import replacing


class JsonLines(Export):
    """Files that end in .jsonl."""

    endings, content = (".jsonl",), "a JSON object for each agent at each frame"

    def write(self, content: Content, out: Path) -> list[str]:
        """See :class:`litsim_data.exports.export.Export`."""
        with replacing(out) as new:
            content.motion().to_json(new, orient="records", lines=True)
        return [content.counts]
