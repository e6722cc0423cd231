"""Plain data with arrays as one compressed text for the page."""

from __future__ import annotations

import base64
import json
import math
import zlib
from typing import Any

import numpy as np

from capsyn.cells.packing import smallest_type


def pack(data: Any) -> str:
    """Return data, as ``json.dumps`` takes them but for arrays, as text: base64 of zlib.

    It holds the bytes of the JSON, after their number in four bytes, and the arrays. In the JSON an
    array is ``{"dtype", "shape", "from", "delta"}``: it begins so many bytes after the JSON, in
    the smallest integers that hold it, first the lowest byte of all values, then the next. Of
    several axes the first goes fastest. With ``delta`` each value but the first is less by the one
    before, modulo its type. The same data give the same text.
    """
    arrays: list[bytes] = []

    def described(array: Any) -> dict[str, Any]:
        if not isinstance(array, np.ndarray):
            raise TypeError(f"a page holds no {type(array).__name__}")
        dtype, values = _narrow(array)
        start = sum(map(len, arrays))
        changes = _bytes(np.diff(values, prepend=values.dtype.type(0)))
        plain = _bytes(values)
        shorter = dtype.kind in "iu" and len(_deflated(changes)) < len(_deflated(plain))
        arrays.append(changes if shorter else plain)
        return {"dtype": dtype.name, "shape": list(array.shape), "from": start, "delta": shorter}

    text = json.dumps(
        data, sort_keys=True, separators=(",", ":"), allow_nan=False, default=described
    ).encode()
    whole = b"".join([len(text).to_bytes(4, "little"), text, *arrays])
    return base64.b64encode(_deflated(whole, 9)).decode()


def _narrow(array: np.ndarray) -> tuple[np.dtype, np.ndarray]:
    """Return the type of an array on the page, and its values (K,), integers without a sign."""
    if array.dtype != np.uint32 and array.dtype.kind in "iu":
        array = array.astype(smallest_type(array))
    values = array.reshape(len(array), math.prod(array.shape[1:])).T.ravel()
    integers = array.dtype.kind in "iu"
    return array.dtype, values.view(f"u{array.itemsize}") if integers else values


def _bytes(values: np.ndarray) -> bytes:
    """Return the lowest bytes of all values, then the next, and so on."""
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return little.view(np.uint8).reshape(-1, values.itemsize).T.tobytes()


def _deflated(data: bytes, level: int = 1) -> bytes:
    return zlib.compress(data, level)
