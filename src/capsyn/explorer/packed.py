"""Arrays as plain data for the page."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from capsyn.cells.packing import smallest_type


def packed_array(array: np.ndarray) -> dict[str, Any]:
    """Return an array as plain data; whole numbers in the smallest type that holds them."""
    if array.dtype != np.uint32 and array.dtype.kind in "iu":
        array = array.astype(smallest_type(array))
    little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    text = base64.b64encode(little.tobytes()).decode()
    return {"dtype": array.dtype.name, "shape": list(array.shape), "base64": text}
