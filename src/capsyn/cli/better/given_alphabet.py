"""Alphabets that options name: the file of a study, or symbols of Python."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from capsyn.errors import warn

if TYPE_CHECKING:
    from capsyn.alphabets.study import AlphabetStudy
    from capsyn.modelling.problem import Problem


def with_given_alphabet(problem: Problem, text: str) -> tuple[Problem, dict[str, Any]]:
    """Return a problem with the alphabet that a text names, and what its statistics say of that.

    The text is the file of a study, or FILE.py:NAME.

    Raises
    ------
    ProblemError
        There is no alphabet, or the problem cannot have it.
    """
    from capsyn.alphabets.candidates import with_alphabet
    from capsyn.cli.problem_finder import find_symbols
    from capsyn.modelling.alphabet import Alphabet

    study = _study(text)
    if study is not None:
        if study.problem != problem.name:
            warn(
                f"the alphabet in '{text}' was chosen for problem '{study.problem}', not "
                f"'{problem.name}'"
            )
        return with_alphabet(problem, study.alphabet), {"alphabet": study.summary()}
    symbols, own = find_symbols(text), problem.alphabet
    if not isinstance(symbols, Alphabet):
        symbols = Alphabet(symbols, inputs=own.inputs, units=own.units)
    return with_alphabet(problem, symbols), {}


def symbols_of(text: str) -> Any:
    """Return the alphabet of a study's file, or the symbols of FILE.py:NAME."""
    study = _study(text)
    if study is not None:
        return study.alphabet
    from capsyn.cli.problem_finder import find_symbols

    return find_symbols(text)


def _study(text: str) -> AlphabetStudy | None:
    """Return the study in a file; None for FILE.py:NAME."""
    from capsyn.alphabets.study import AlphabetStudy

    place, _, name = text.rpartition(":")
    of_python = (place and name.isidentifier()) or text.endswith(".py")
    return None if of_python else AlphabetStudy.load(text)
