"""Every exception and warning of capsyn."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence


class CapsynError(Exception):
    """The base class of every error that capsyn raises on purpose."""


class ProblemError(CapsynError, ValueError):
    """An argument, a model or a setting that cannot be used; the message names it."""


class PolicyFormatError(CapsynError, ValueError):
    """A file that is no policy, or that is damaged, tampered with or too new."""


class OutsideDomainError(CapsynError, ValueError):
    """A state that is outside the domain or not finite, under the policy's rule ``"error"``."""


class SynthesisError(CapsynError, RuntimeError):
    """A synthesis that had to stop, for instance because too many solves were not finite."""


class CertificateError(CapsynError, ValueError):
    """A certificate that does not prove what it says, or that belongs to another policy."""


class KernelBuildError(CapsynError, RuntimeError):
    """The C backend was asked for, but could not be built.

    Attributes
    ----------
    command : list of str
        The compiler command that failed; empty when no compiler was found.
    output : str
        What the compiler printed.
    """

    def __init__(self, message: str, command: Sequence[str] = (), output: str = "") -> None:
        super().__init__(message)
        self.command = list(command)
        self.output = output


class CapsynWarning(UserWarning):
    """A warning about something that the user should know, which does not stop the work."""


def warn(message: str) -> None:
    """Give a `CapsynWarning` that points at the line outside capsyn which led to it."""
    frame, level = sys._getframe(1), 2
    while frame.f_globals.get("__name__", "").partition(".")[0] == "capsyn" and frame.f_back:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, CapsynWarning, stacklevel=level)
