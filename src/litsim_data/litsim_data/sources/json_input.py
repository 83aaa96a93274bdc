"""Reading of JSON files of users."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from litsim_sim.core.errors import InputError


def read_json(path: Path, what: str) -> Any:
    """Returns the content of a JSON file.

    Raises:
        InputError: the file is missing or no JSON; `what` says what is expected.
    """
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file, expected {what}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not readable as JSON, expected {what}: {error}") from error
