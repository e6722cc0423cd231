"""Options that commands share, and the texts that they take."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Ball, Box

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem
    from capsyn.modelling.switching import Switching

Json = Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")]
File = Annotated[str, typer.Argument(metavar="FILE", help="A policy file.")]
MinDwell = Annotated[
    float | None,
    typer.Option(
        help="Least time between switches [time unit] [default: the problem's or policy's]."
    ),
]
Outside = Annotated[
    str | None,
    typer.Option(
        help="What a state outside the domain gets: error, nearest, or a symbol's name or index "
        "[default: the problem's or policy's]."
    ),
]
Current = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="The symbol in force [default: the default control, as before the first decision].",
    ),
]
OutsideAtOnce = Annotated[
    bool | None,
    typer.Option(
        help="Whether the symbol of a state outside the domain is taken at once, without waiting "
        "for a least time [default: as the problem or policy says]."
    ),
]
INITIAL = "NAME=LOW:HIGH or NAME=VALUE[,..] [default: the domain]."
"""Help of the option that says where loops start."""
Seed = Annotated[int, typer.Option(help="Seed of all random numbers.")]
Backend = Annotated[str, typer.Option(help="How to compute: auto, c (compiled) or numpy.")]
Threads = Annotated[
    int | None, typer.Option(help="Number of threads [default: one per processor].")
]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Let the workers of a Dask scheduler do the work, or local:N worker processes.",
    ),
]


def option(
    help: str, *names: str, default: Any = None, before: str | None = None, **more: Any
) -> Any:
    """Return a field that `flat` makes an option of, with what `typer.Option` takes.

    `before` says where the help has an option that a subclass adds: before that one.
    """
    extra = {"option": typer.Option(*names, help=help, **more), "before": before}
    return dataclasses.field(default=default, metadata=extra)


def absent() -> Any:
    """Return a field that is an option of the class above, but none here."""
    return dataclasses.field(default=None, metadata={"absent": True})


def as_in(options: Any, name: str) -> Any:
    """Return a field that is the same option as that of another dataclass of options."""
    field = options.__dataclass_fields__[name]
    return dataclasses.field(default=field.default, metadata=field.metadata | {"before": None})


def option_name(field: str) -> str:
    """Return the option of a field, as ``--max-level`` of ``max_level``."""
    return f"--{field.replace('_', '-')}"


def flat(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command for Typer, each of whose dataclasses of options is one option a field.

    The fields stand in the place of the parameter; the command is called with one value.
    """
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        kind = parameter.annotation
        if dataclasses.is_dataclass(kind):
            groups[name] = kind
            parameters += _field_parameters(kind)
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def flattened(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{f.name: values.pop(f.name) for f in _fields(kind)})
        command(**values)

    flattened.__annotations__ = {p.name: p.annotation for p in parameters}
    flattened.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return flattened


def _fields(kind: Any) -> list[Any]:
    return [f for f in dataclasses.fields(kind) if not f.metadata.get("absent")]


def _field_parameters(kind: Any) -> list[inspect.Parameter]:
    """Return the fields of a dataclass as parameters, in the order of the help."""
    hints, ordered = get_type_hints(kind, include_extras=True), list[inspect.Parameter]()
    for field in dataclasses.fields(kind):
        default = inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default
        hint, extra = hints[field.name], field.metadata
        parameter = inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[hint, extra["option"]] if "option" in extra else hint,
        )
        names = [p.name for p in ordered]
        before = extra.get("before")
        ordered.insert(names.index(before) if before else len(names), parameter)
    given = {field.name for field in _fields(kind)}
    return [parameter for parameter in ordered if parameter.name in given]


@dataclasses.dataclass(frozen=True)
class SwitchingOptions:
    """A `capsyn.Switching` as texts, and the delay that is compensated."""

    switch_price: str | None = option(
        "Price of a switch: a number [cost / time unit], a share such as 1%, or INPUT=P,.. "
        "for each unit by which an input changes. none makes a policy that forgets the "
        "symbol in force [default: the problem's].",
        metavar="P|INPUT=P[,..]|none",
    )
    hold: list[str] | None = option(
        "Least time of all symbols, or of some symbols or inputs, beside the problem's own "
        "times [time unit]. none takes all least times away. May be repeated.",
        metavar="T|NAME=T[,..]|none",
    )
    forbid: list[str] | None = option(
        "Pairs of symbols between which a switch is forbidden, beside the problem's own "
        "pairs. none allows all switches. May be repeated.",
        metavar="FROM:TO[,..]|none",
    )
    delay: float | None = option(
        "Known delay of the input, which the policy compensates [time unit]."
    )

    def of(self, problem: Problem) -> Switching | None:
        """Return the problem's `Switching`, changed, or a new one; None for none."""
        from capsyn.modelling.switching import Switching

        changes: dict[str, Any] = {}
        if self.switch_price == "none":
            if self.hold or self.forbid:
                raise ProblemError("--switch-price none takes no --hold and no --forbid")
            return None
        own = problem.switching or Switching()
        if self.switch_price is not None:
            changes["price"] = _one_or_named("--switch-price", self.switch_price, price)
        if self.hold:
            changes["hold"] = _holds(self.hold, own.hold, problem.alphabet.names)
        if self.forbid:
            changes["forbidden"] = _pairs(self.forbid, own.forbidden)
        if not changes:
            return problem.switching
        return dataclasses.replace(own, **changes)


@dataclasses.dataclass(frozen=True)
class LimitOptions:
    """How the limits of a problem are kept."""

    keep_limits: bool = option(
        "Keep the problem's limits by construction, at the problem's sample time, wherever "
        "this is possible.",
        "--keep-limits",
        default=False,
    )
    limit_cells: str | None = option(
        "Cells along each axis of the set in which limits are kept [default: chosen].",
        metavar="K[,K..]",
    )

    def of(self) -> Any:
        """Return the argument ``keep_limits`` of `capsyn.synthesize`."""
        from capsyn.limits.asked import KeepLimits

        cells = whole_number_list("--limit-cells", self.limit_cells)
        if cells is not None and not self.keep_limits:
            raise ProblemError("--limit-cells is for --keep-limits only")
        return KeepLimits(cells) if self.keep_limits else False


def _holds(texts: list[str], own: Any, names: Sequence[str]) -> Any:
    """Return the least times that texts mean, by name beside those of the problem."""
    if texts == ["none"]:
        return 0.0
    meant = [_one_or_named("--hold", text, number) for text in texts]
    if not all(isinstance(times, dict) for times in meant):
        if len(meant) > 1:
            raise ProblemError(f"--hold must be one time, or NAME=T; got '{' '.join(texts)}'")
        return meant[0]
    if not isinstance(own, dict):  # one time for all, or one for each
        each = own if isinstance(own, tuple) else [own] * len(names)
        own = {name: time for name, time in zip(names, each) if time}
    for times in meant:
        own = own | times
    return own


def _pairs(texts: list[str], own: Sequence[tuple[str, str]]) -> list[Any]:
    """Return the forbidden transitions that texts mean, beside those of the problem."""
    if texts == ["none"]:
        return []
    pairs = [[name.strip() for name in part.split(":")] for text in texts for part in parts(text)]
    if any(len(pair) != 2 for pair in pairs):
        raise ProblemError(f"--forbid must be FROM:TO; got '{' '.join(texts)}'")
    return [*own, *pairs]


def parts(text: str) -> list[str]:
    """Return the parts of a list of names, whose commas are not those in brackets, ``(0, 1)``."""
    return [part.strip() for part in re.split(r",(?![^()]*\))", text)]


def price(name: str, text: str) -> Any:
    """Return a number, or a share as text."""
    return text if text.endswith("%") else number(name, text)


def _one_or_named(name: str, text: str, meaning: Callable[[str, str], Any]) -> Any:
    """Return what a text means, or of ``NAME=TEXT,..`` what each does, by name."""
    if "=" not in text:
        return meaning(name, text)
    each = assignments(name, parts(text))
    return {key: meaning(name, value) for key, value in each.items()}


@contextlib.contextmanager
def executor(address: str | None) -> Iterator[Any]:
    """Yield the Dask client of an address; None for None."""
    if address is None:
        yield None
        return
    from capsyn.execution.cluster import connect
    from capsyn.execution.interrupts import lasting

    with lasting(), connect(address) as client:
        yield client


def listed(text: str) -> list[str]:
    """Return the parts of a list such as ``a, b``, without the blanks around them."""
    return [part.strip() for part in text.split(",")]


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


def number_or_range(name: str, text: str) -> Any:
    """Return the numbers of a text, or the `Uniform` of LOW:HIGH."""
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
    """Return the texts of items such as ``NAME=TEXT``, each name once, without outer blanks."""
    values: dict[str, str] = {}
    for item in items:
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or key in values:
            raise ProblemError(f"{name} must be NAME=VALUE, once for a name; got '{item}'")
        values[key] = value
    return values


def check_states(name: str, texts: Sequence[str], known: Sequence[str]) -> None:
    """Raise `ProblemError` at the first name that is not that of a state."""
    unknown = [text for text in texts if text not in known]
    if unknown:
        raise ProblemError(f"{name} must name states among {', '.join(known)}; got '{unknown[0]}'")


def region(
    name: str, text: str, known: Sequence[str], tolerance: float | None = None
) -> Ball | Box:
    """Return the box of ``NAME=LOW:HIGH,..``, or the ball around ``NAME=VALUE,..``."""
    names, bounds = _bounds(name, text, known)
    if all(len(pair) == 2 for pair in bounds) and tolerance is None:
        lower, upper = zip(*bounds)
        return Box(lower, upper, names=names)
    if all(len(pair) == 1 for pair in bounds) and tolerance is not None:
        return Ball([pair[0] for pair in bounds], tolerance, names=names)
    raise ProblemError(
        f"{name} must be NAME=LOW:HIGH,.., or NAME=VALUE,.. with --tolerance; got '{text}'"
        + (" with it" if tolerance is not None else "")
    )


def starts(text: str | None, known: Sequence[str]) -> Box | None:
    """Return where ``--initial`` says that loops start: a range of a state, or one value."""
    if text is None:
        return None
    names, bounds = _bounds("--initial", text, known)
    if max(map(len, bounds)) > 2:
        raise ProblemError(f"--initial must be NAME=LOW:HIGH or NAME=VALUE,..; got '{text}'")
    return Box([pair[0] for pair in bounds], [pair[-1] for pair in bounds], names=names)


def _bounds(name: str, text: str, known: Sequence[str]) -> tuple[list[str], list[list[float]]]:
    """Return the states that a set is about, and what stands between colons for each."""
    parts = assignments(name, listed(text))
    check_states(name, list(parts), known)
    return list(parts), [[number(k, value) for value in v.split(":")] for k, v in parts.items()]
