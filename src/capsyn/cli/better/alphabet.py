"""The command that chooses the alphabet of a problem."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from capsyn.cli.better.given_alphabet import symbols_of
from capsyn.cli.better.searches import RUN_BY, SearchTexts
from capsyn.cli.console import print_line, print_table, show, working
from capsyn.cli.options import (
    Json,
    absent,
    assignments,
    flat,
    listed,
    number,
    option,
    parts,
    whole_number_list,
)
from capsyn.errors import ProblemError
from capsyn.execution.interrupts import advise

if TYPE_CHECKING:
    from capsyn.alphabets.judged import Judged
    from capsyn.alphabets.study import AlphabetStudy
    from capsyn.modelling.problem import Problem

ONE_OF = ("candidates", "box", "combinations")
"""Options of which one says what the candidates are."""
FEW = 0.5
"""A chosen alphabet of which a smaller share of the loops succeeds gets a hint."""


@dataclass(frozen=True)
class AlphabetOptions(SearchTexts):
    """Options of ``capsyn alphabet``."""

    output: str | None = option(
        "The file of the study [default: NAME-alphabet.json].",
        "--output",
        "-o",
        metavar="FILE",
        before="duration",
    )
    candidates: str | None = option(
        "The candidates: a capsyn.Alphabet, numbers, or a capsyn.Box of inputs.",
        metavar="FILE.py:NAME",
        before="duration",
    )
    box: str | None = option(
        "Candidates on a grid of the inputs, the range of each: LOW:HIGH[,LOW:HIGH..].",
        metavar="LOW:HIGH[,..]",
        before="duration",
    )
    steps: str | None = option(
        "Levels of each input of the grid [default: chosen].", metavar="K[,K..]", before="duration"
    )
    combinations: int | None = option(
        "Candidates that are combinations of at most N inputs that leave their rest.",
        metavar="N",
        before="duration",
    )
    count: str | None = option(
        "Most symbols. Of several numbers, the least objective wins [default: 2 to 8].",
        metavar="N[,N..]",
        before="duration",
    )
    objective: list[str] | None = option(
        "What is made least, weights of figures of a closed loop: cost, effort, fuel, time, "
        "switches and failures [default: cost]. May be repeated.",
        metavar="NAME=WEIGHT[,..]",
        before="duration",
    )
    keep: list[str] | None = option(
        "Candidates that every alphabet has, by name. May be repeated.",
        metavar="NAME[,..]",
        before="duration",
    )
    exclude: list[str] | None = option(
        "Candidates that no alphabet has, by name. May be repeated.",
        metavar="NAME[,..]",
        before="duration",
    )
    price: list[str] | None = option(
        "Price of a symbol, which is added to the objective. May be repeated.",
        metavar="NAME=VALUE",
        before="duration",
    )
    own: list[str] | None = option(
        "An alphabet from which the search starts too, and which is judged: that of a study, or "
        "of Python. May be repeated.",
        metavar="FILE.json|FILE.py:NAME",
        before="duration",
    )
    cost: str | None = option(
        "Cost that loops gather, a function of x (and w) [default: the problem's running cost].",
        metavar="FILE.py:NAME",
        before="duration",
    )
    starts: int = option(
        "Number of closed loops from which an alphabet is chosen.", default=100, before="duration"
    )
    fresh: int = option(
        "Number of closed loops that judge the alphabets.", default=1000, before="duration"
    )
    storage: str | None = option(
        "Where what was tried is kept: a SQLite file. A search that was killed goes on from there.",
        metavar="FILE",
        before="duration",
    )
    policies: bool = option(
        "Whether the alphabets of the table get a policy, whose size is told.",
        default=True,
        before="duration",
    )
    plot: str | None = option(
        "A picture of the table: a .png, .pdf or .svg file.", metavar="FILE", before="duration"
    )
    report: str | None = option(
        "The study as a document, with its table and picture: an .html file.",
        metavar="FILE",
        before="duration",
    )
    not_asked: ClassVar[tuple[str, ...]] = (*RUN_BY, "model", "parameters", "min_dwell")
    model: None = absent()
    parameter: None = absent()
    min_dwell: None = absent()


@flat
def alphabet(
    problem: Annotated[
        str, typer.Argument(metavar="PROBLEM", help="The problem, written as for synth.")
    ],
    *,
    options: AlphabetOptions,
    as_json: Json = False,
) -> None:
    """Choose the alphabet of a problem among candidates, by closed loops."""
    from capsyn.alphabets.choose import choose_alphabet
    from capsyn.cli.problem_finder import find_function, find_problem

    advise(
        "--storage FILE would keep what was tried for the next run"
        if options.storage is None
        else f"the same command goes on from what '{options.storage}' keeps"
    )
    given = find_problem(problem)
    path = options.output or f"{given.name}-alphabet.json"
    _check_outputs(path, options)
    candidates = _candidates(given, options)
    names = "starts fresh storage policies seed backend threads".split()
    arguments: dict[str, Any] = {name: getattr(options, name) for name in names} | {
        "count": whole_number_list("--count", options.count),
        "objective": _objective(options.objective),
        "steps": whole_number_list("--steps", options.steps),
        "cost": None if options.cost is None else find_function(options.cost),
        "keep": _names(options.keep),
        "exclude": _names(options.exclude),
        "prices": _prices(options.price),
        "own": [symbols_of(text) for text in options.own or []],
        "synthesis": options.solves,
    }
    with working("looking at the candidates") as say:
        study = choose_alphabet(
            given, candidates, progress=say, **arguments, **options.loops(given)
        )
    written = ", ".join(_written(study, path, options))
    data = study.to_json() | {"file": path}
    again = f"capsyn synth {problem} --alphabet {path}{options.synth}"
    show(as_json, data, lambda: _print(study), f"wrote {written}; {again} makes the policy")


def _check_outputs(path: str, options: AlphabetOptions) -> None:
    """Raise `ProblemError` unless all files can be written."""
    from capsyn.execution.files import check_writable
    from capsyn.plots.figure import FORMATS, check_format

    if options.plot is not None:
        check_format(options.plot, FORMATS, "--plot")
    if options.report is not None:
        check_format(options.report, ["html"], "--report")
    for file in (path, options.plot, options.report):
        if file is not None:
            check_writable(file)


def _written(study: AlphabetStudy, path: str, options: AlphabetOptions) -> list[str]:
    """Write the files of a study, and return their names."""
    from capsyn.alphabets.document import save_document
    from capsyn.plots.alphabet import save_alphabet_plot

    study.save(path)
    if options.plot is not None:
        save_alphabet_plot(study.table, study.objective, study.problem, options.plot, study.count)
    if options.report is not None:
        save_document(study, options.report)
    return [file for file in (path, options.plot, options.report) if file is not None]


def _candidates(problem: Problem, options: AlphabetOptions) -> Any:
    """Return the candidates that options mean, as `capsyn.choose_alphabet` takes them."""
    given = [name for name in ONE_OF if getattr(options, name) is not None]
    if len(given) != 1:
        told = " and ".join(f"--{name}" for name in given) or "none"
        wanted = ", ".join(f"--{name}" for name in ONE_OF)
        raise ProblemError(f"candidates must be given by one of {wanted}; got {told}")
    if options.steps is not None and options.box is None:
        raise ProblemError("--steps needs --box")
    if options.candidates is not None:
        from capsyn.cli.problem_finder import find_symbols

        return find_symbols(options.candidates)
    if options.combinations is not None:
        from capsyn.alphabets.candidates import actuator_combinations

        try:
            return actuator_combinations(problem, options.combinations)
        except ProblemError as error:
            raise ProblemError(str(error).replace("`most`", "--combinations")) from None
    assert options.box is not None
    return _box(options.box, problem.alphabet.inputs)


def _box(text: str, inputs: Sequence[str]) -> Any:
    """Return the box of inputs that ``LOW:HIGH,..`` means."""
    from capsyn.modelling.domain import Box

    bounds = [[number("--box", end) for end in part.split(":")] for part in listed(text)]
    if [len(pair) for pair in bounds] != [2] * len(inputs):
        wanted = f"LOW:HIGH for each input ({', '.join(inputs)})"
        raise ProblemError(f"--box must be {wanted}; got '{text}'")
    if not all(-math.inf < low < high < math.inf for low, high in bounds):
        raise ProblemError(f"--box must be LOW:HIGH, finite and LOW < HIGH; got '{text}'")
    return Box(*zip(*bounds))


def _objective(texts: list[str] | None) -> dict[str, float] | None:
    """Return the weights by name of ``NAME=WEIGHT,..``; a name alone has weight 1."""
    if not texts:
        return None
    each = [part for text in texts for part in listed(text)]
    given = assignments("--objective", [part if "=" in part else f"{part}=1" for part in each])
    return {name: number(f"--objective {name}", text) for name, text in given.items()}


def _names(texts: list[str] | None) -> list[str]:
    return [name for text in texts or [] for name in parts(text)]


def _prices(texts: list[str] | None) -> dict[str, float]:
    """Return prices by name; the name of a symbol may have an equals sign."""
    prices: dict[str, float] = {}
    for text in texts or []:
        name, equals, value = (part.strip() for part in text.rpartition("="))
        if not equals or name in prices:
            raise ProblemError(f"--price must be NAME=VALUE, once for a name; got '{text}'")
        prices[name] = number(f"--price {name}", value)
    return prices


def _print(study: AlphabetStudy) -> None:
    """Print the table, what was chosen, and from what."""
    from capsyn.alphabets.judged import brief, chosen_among

    summary = study.summary()
    if study.table:
        print_table(brief(summary["rows"], study.objective, study.time_unit, study.count))
    print_line("alphabet", ", ".join(study.alphabet.names))
    print_line("", chosen_among(summary))
    for row in study.chosen:
        if row.count == study.count and (hint := _hint(row, study)):
            print_line("hint", hint)


def _hint(row: Judged, study: AlphabetStudy) -> str | None:
    """Return what to do about loops of the chosen alphabet that are lost, or do not succeed."""
    if row.lost:
        lost = "all" if row.lost == study.fresh else f"{row.lost:,} of {study.fresh:,}"
        return (
            f"{lost} closed loops of the chosen alphabet are lost (out of the domain, or not "
            "finite), so its objective is infinite: try --outside nearest, or a smaller --initial"
        )
    if row.success is not None and row.success < FEW:
        weigh = (
            "" if study.objective.get("failures") else " weigh them (failures=3 in --objective),"
        )
        return (
            f"only {row.success:.1%} of the closed loops of the chosen alphabet succeed:{weigh} "
            "let loops run longer (--duration), or offer stronger candidates"
        )
    return None
