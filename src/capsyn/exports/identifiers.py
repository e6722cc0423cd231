"""Names of states, inputs and symbols as identifiers of a target language."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Sequence

from capsyn.errors import ProblemError
from capsyn.validation import describe

LONGEST_FILE_NAME = 64
"""Most characters of a name that files are called by."""


def identifiers(
    names: Sequence[str], keywords: Collection[str] = (), fold: bool = False
) -> tuple[str, ...]:
    """Return identifiers for names, in order, each different.

    Letters are taken without accents; a plus sign, and a minus sign of a number or at the end of a
    word, become words; everything else than letters, digits and underscores becomes an underscore;
    a digit in front gets an ``n``; `keywords`, with names in use, and names that end up empty get a
    number. `fold` is whether the language takes capital and small letters as the same.
    """

    def key(text: str) -> str:
        return text.lower() if fold else text

    taken = {key(word) for word in keywords}
    chosen: list[str] = []
    for name in names:
        plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
        plain = re.sub(r"(?<![A-Za-z0-9])-(?=[0-9.])", "minus_", plain)
        plain = re.sub(r"-(?![A-Za-z0-9 ])", "_minus_", plain.replace("+", "_plus_"))
        plain = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9_]", "_", plain)).strip("_")
        if not plain or plain[0].isdigit():
            plain = f"n{plain}"
        free, k = plain, 2
        while key(free) in taken:
            free, k = f"{plain}_{k}", k + 1
        taken.add(key(free))
        chosen.append(free)
    return tuple(chosen)


def wanted_name(name: str | None, policy: str) -> str:
    """Return a name that is asked for, or else a policy's."""
    if name is not None and not (isinstance(name, str) and name and name.isprintable()):
        raise ProblemError(f"`name` must be a printable text; got {describe(name)}")
    return policy if name is None else name


def file_name(name: str | None, policy: str, keywords: Collection[str] = ()) -> str:
    """Return an identifier of a name that is asked for, or else of a policy's."""
    return identifiers([wanted_name(name, policy)[:LONGEST_FILE_NAME]], keywords)[0]


def renamed(names: Sequence[str], chosen: Sequence[str]) -> dict[str, str]:
    """Return the names that had to change, and into what."""
    return {name: new for name, new in zip(names, chosen) if name != new}
