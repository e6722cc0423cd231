"""C as text: comments, literals, tables in program memory, reserved words."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

KEYWORDS = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while".split()
)
"""Words of C."""
RESERVED = KEYWORDS | frozenset(
    "bool true false main example arduino "
    "and or not xor class new delete this template typename namespace operator private protected "
    "public friend virtual explicit export using try catch throw "
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal "
    "stdalign stdarg stdatomic stdbool stddef stdint stdio stdlib stdnoreturn string tgmath "
    "threads time uchar wchar wctype "
    "all all_build clean depend edit_cache help install list_install_components none package "
    "package_source preinstall rebuild_cache run_tests test zero_check".split()
)
"""Names that no library of ours may have, in capital or small letters: words of C and C++, names
of their headers, and targets that CMake keeps for itself."""
LONGEST_PREFIX = 18
"""Names that differ do so within 31 characters, as C99 and MISRA ask: a prefix gets this many."""
WIDTH = 100
"""Columns of a line."""
BYTES_IN_LINE = 22
"""Entries of a table of bytes in a line."""
ENTRIES = {
    "BYTE": "pgm_read_byte(place)",
    "INT8": "((int8_t)pgm_read_byte(place))",
    "INT16": "((int16_t)pgm_read_word(place))",
    "INT32": "((int32_t)pgm_read_dword(place))",
    "UINT32": "pgm_read_dword(place)",
    "FLOAT": "pgm_read_float(place)",
}
"""Kinds of table entries, and how an AVR reads them from program memory."""


@dataclass(frozen=True)
class Part:
    """Definitions of functions of C, and what of `ENTRIES` they read from tables."""

    text: str
    reads: frozenset[str] = frozenset()


def comment(lines: Iterable[str]) -> str:
    """Return lines as a comment, which nothing within them can end."""
    safe = []
    for line in lines:
        line = line.replace("\\", "/")
        for mark in ("*/", "/*", "//", "??"):
            while mark in line:
                line = line.replace(mark, f"{mark[0]} {mark[1]}")
        safe += textwrap.wrap(line, WIDTH - 6, subsequent_indent="  ") or [""]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in safe), " */"])


def macros(reads: Iterable[str]) -> str:
    """Return the macros for tables in program memory; on an AVR they are there by themselves."""
    used = [kind for kind in ENTRIES if kind in reads]
    flash = "".join(f"#define CAPSYN_{kind}(place) {ENTRIES[kind]}\n" for kind in used)
    plain = "".join(f"#define CAPSYN_{kind}(place) (*(place))\n" for kind in used)
    return f"""#if defined(__AVR__) /* tables stay in program memory */
#include <avr/pgmspace.h>
#define CAPSYN_ROM PROGMEM
#define CAPSYN_COPY(to, place) ((void)memcpy_P(&(to), (place), sizeof(to)))
{flash}#else
#define CAPSYN_ROM
#define CAPSYN_COPY(to, place) ((to) = *(place))
{plain}#endif
"""


def with_called(functions: Sequence[str], body: str) -> str:
    """Return a body behind those of some functions that it calls, itself or through others.

    Each function is a definition that begins with ``static``; callees stand before callers.
    """
    text = body
    for function in reversed(functions):
        (name,) = re.findall(r"^static [^(]*?(\w+)\(", function, re.M)
        if re.search(rf"\b{name}\(", text):
            text = function + text
    return text


def literal(value: float, real: str) -> str:
    """Return the shortest literal of a type, double or float."""
    if real == "double":
        return repr(float(value))
    text = str(np.float32(value))
    return text + ("f" if "." in text or "e" in text else ".0f")


def round_up(values: np.ndarray) -> np.ndarray:
    """Return the least floats not below doubles: a float is ``>= value`` just when ``>= up``."""
    nearest = np.asarray(values, dtype=np.float64).astype(np.float32)
    above = np.nextafter(nearest, np.float32(np.inf))
    return np.where(nearest.astype(np.float64) >= values, nearest, above).astype(np.float32)


def rows(entries: Sequence[str], indent: int = 8) -> str:
    """Return entries of a table, separated by commas, in lines."""
    pad = " " * indent
    return textwrap.fill(
        ", ".join(entries), WIDTH, initial_indent=pad, subsequent_indent=pad, break_on_hyphens=False
    )


def byte_rows(data: bytes) -> str:
    """Return bytes as entries of a table, close together: tables are most of a large source."""
    lines = [data[k : k + BYTES_IN_LINE] for k in range(0, len(data), BYTES_IN_LINE)]
    return ",\n".join(" " * 8 + ",".join(map(str, line)) for line in lines)


def constants(name: str, integer: str, values: Sequence[int]) -> str:
    """Return the definition, within a function, of a table of whole numbers."""
    suffix = "uL" if integer == "uint32_t" else ""
    entries = rows([f"{value}{suffix}" for value in values])
    if integer == "uint8_t":
        entries = byte_rows(bytes(values))
    return f"    static const {integer} {name}[{len(values)}] CAPSYN_ROM = {{\n{entries}\n    }};\n"


def place_type(size: int) -> str:
    """Return the type of places in a table."""
    return "uint16_t" if size < 1 << 16 else "uint32_t"


def z_type(counts: Sequence[int]) -> str:
    """Return the integer type of lattice steps."""
    return "int16_t" if max(counts) <= 32767 else "int32_t"


def search(integer: str, high: str, reached: str) -> str:
    """Return statements that leave the last of 0 .. high - 1 that is reached, else 0, in ``low``.

    `reached` is the condition at ``middle``.
    """
    return f"""\
    {integer} low = 0;
    {integer} high = {high};
    while ((high - low) > 1) {{
        const {integer} middle = ({integer})(low + ((high - low) / 2));
        if ({reached}) {{
            low = middle;
        }} else {{
            high = middle;
        }}
    }}"""
