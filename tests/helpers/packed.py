"""Reader of the containers of ``litsim_eval.report.packing``, like `assets/container.js` in the browser."""

import base64
import gzip
import json
import re
from typing import Any

import numpy as np
import numpy.typing as npt

from litsim_eval.report.packing import WHOLE


def unpack(text: str) -> tuple[dict[str, Any], dict[str, npt.NDArray[np.float64]]]:
    """Content and arrays of a container, as the page reads them."""
    data = gzip.decompress(base64.b64decode(text))
    start = 4 + int.from_bytes(data[:4], "little")
    content = json.loads(data[4:start])
    arrays: dict[str, npt.NDArray[np.float64]] = {}
    for each in content.pop("arrays"):
        kind, count = np.dtype(each["kind"]).newbyteorder("<"), int(np.prod(each["shape"]))
        whole = np.frombuffer(data, kind, count, start + each["offset"]).reshape(each["shape"]).astype(WHOLE)
        for _ in range(each["differences"]):
            whole = np.cumsum(whole, axis=-1, dtype=WHOLE)
        arrays[each["name"]] = whole.astype(np.float64) * each["resolution"]
    return content, arrays


def of_page(html: str) -> tuple[dict[str, Any], dict[str, npt.NDArray[np.float64]]]:
    """Content and arrays of the container in a page, which is of letters that cannot end a script."""
    data = re.search(r'<script id="data" type="text/plain">([A-Za-z0-9+/=]*)</script>', html)
    assert data
    return unpack(data[1])
