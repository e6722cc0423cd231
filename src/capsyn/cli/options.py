"""Options that commands share, and the texts that they take."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Ball, Box

Json = Annotated[bool, typer.Option("--json", help="Print figures as JSON.")]
File = Annotated[str, typer.Argument(metavar="FILE", help="A policy file.")]
Rate = Annotated[
    float | None, typer.Option(help="Samples per second [default: by the policy's settings, 1000].")
]
ModelOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="PLANT",
        help="Another plant: a problem as for synth, or FILE.py:NAME of a function of x and u, "
        "and of p where there are parameters; a policy without a model, such as an imported one, "
        "takes a problem only.",
    ),
]
Parameters = Annotated[
    list[str] | None,
    typer.Option(
        "--parameter",
        metavar="NAME=P[:P]",
        help="A component of p, in the order of p; verify takes a range, too. May be repeated.",
    ),
]
Noise = Annotated[
    str | None,
    typer.Option(
        metavar="S[,S..]",
        help="Standard deviation of the measured states, of all or of each; verify takes a range "
        "S[,S..]:S[,S..], too.",
    ),
]
Disturbance = Annotated[
    str | None,
    typer.Option(
        metavar="D[,D..]",
        help="Added to the rates, of all states or of each; verify takes a range D[,D..]:D[,D..], "
        "too.",
    ),
]
Delay = Annotated[
    str | None,
    typer.Option(metavar="T", help="Input delay [s]; verify takes a range T:T, too."),
]
MinDwell = Annotated[
    float | None,
    typer.Option(help="Least time between switches [s] [default: the problem's or policy's]."),
]
Outside = Annotated[
    str | None,
    typer.Option(
        help="error, nearest, or a symbol's name or index [default: the problem's or policy's]."
    ),
]
Target = Annotated[
    str | None,
    typer.Option(
        metavar="SET",
        help="NAME=LOW:HIGH[,..], NAME=VALUE[,..] with --tolerance, or FILE.py:NAME of a "
        "function of x that says whether it has arrived.",
    ),
]
Online = Annotated[
    str | None,
    typer.Option(help="ssac or sac: solve online in receding horizon instead of the policy."),
]
Background = Annotated[
    bool, typer.Option(help="Let the policy be the default control of the online controller.")
]
Seed = Annotated[int, typer.Option(help="Of everything that is random.")]
Backend = Annotated[str, typer.Option(help="auto, c or numpy.")]
Threads = Annotated[int | None, typer.Option(help="Default: one per processor.")]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Work on the workers of a Dask scheduler, or on local:N worker processes.",
    ),
]


@contextlib.contextmanager
def executor(address: str | None) -> Iterator[Any]:
    """Yield the Dask client of an address; None for None."""
    if address is None:
        yield None
        return
    from capsyn.execution.cluster import connect

    with connect(address) as client:
        yield client


def number(name: str, text: str) -> float:
    """Return the number that a text is."""
    try:
        return float(text)
    except ValueError:
        raise ProblemError(f"`{name}` must be a number; got '{text}'") from None


def number_list(name: str, text: str) -> list[float]:
    """Return the numbers of a text such as ``1,2.5``."""
    return [number(name, part) for part in text.split(",")]


def one_or_list(name: str, text: str) -> Any:
    """Return a number, or the numbers of a list."""
    values = number_list(name, text)
    return values[0] if len(values) == 1 else values


def number_or_range(name: str, text: str | None) -> Any:
    """Return the numbers of a text, or the `Uniform` of LOW:HIGH."""
    if text is None:
        return None
    low, colon, high = text.partition(":")
    if not colon:
        return one_or_list(name, text)
    if ":" in high:
        raise ProblemError(f"{name} must be a value or a range LOW:HIGH; got '{text}'")
    from capsyn.verification.trials import Uniform

    return Uniform(one_or_list(name, low), one_or_list(name, high))


def whole_number_list(name: str, text: str | None) -> list[int] | int | None:
    """Return a whole number, or the numbers of a list such as ``9,5``; None for None."""
    if text is None:
        return None
    try:
        values = [int(part) for part in text.split(",")]
    except ValueError:
        raise ProblemError(f"{name} must be whole numbers such as 9 or 9,5; got '{text}'") from None
    return values[0] if len(values) == 1 else values


def assignments(name: str, items: list[str]) -> dict[str, str]:
    """Return the texts of items such as ``NAME=TEXT``, each name once."""
    found: dict[str, str] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not equals or key in found:
            raise ProblemError(f"{name} must be NAME=VALUE, once for a name; got '{item}'")
        found[key] = value
    return found


def check_states(name: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Raise `ProblemError` at the first name that is not that of a state."""
    for unknown in (text for text in given if text not in known):
        raise ProblemError(f"{name} must name states among {', '.join(known)}; got '{unknown}'")


def region(
    name: str, text: str, known: Sequence[str], tolerance: float | None = None
) -> Ball | Box:
    """Return the box of ``NAME=LOW:HIGH,..``, or the ball around ``NAME=VALUE,..``."""
    parts = assignments(name, text.split(","))
    names = list(parts)
    check_states(name, names, known)
    bounds = [[number(key, value) for value in parts[key].split(":")] for key in names]
    if all(len(pair) == 2 for pair in bounds) and tolerance is None:
        lower, upper = zip(*bounds)
        return Box(lower, upper, names=names)
    if all(len(pair) == 1 for pair in bounds) and tolerance is not None:
        return Ball([pair[0] for pair in bounds], tolerance, names=names)
    raise ProblemError(
        f"{name} must be NAME=LOW:HIGH,.., or NAME=VALUE,.. with --tolerance; got '{text}'"
        + (" with it" if tolerance is not None else "")
    )
