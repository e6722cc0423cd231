"""The commands that prove what a policy's loop does from a set, and check such a proof."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsyn.cli.console import print_line, show, working
from capsyn.cli.loop import ControllerTexts, LoopTexts, region_or_function, sampled_options
from capsyn.cli.options import (
    INITIAL,
    File,
    Json,
    MinDwell,
    Seed,
    Threads,
    as_in,
    flat,
    number,
    one_or_list,
    option,
    option_name,
    starts,
    whole_number_list,
)
from capsyn.cli.proofs.proved import print_certificate
from capsyn.errors import CertificateError, ProblemError
from capsyn.execution.interrupts import lasting
from capsyn.verification.sentences import simulate_line

if TYPE_CHECKING:
    from capsyn.certification.certificate import Certificate

REQUIREMENTS = ("arrival", "staying")
"""Shares of a certificate that may be required."""


@dataclass(frozen=True)
class CertifyOptions:
    """Options of ``capsyn certify``."""

    initial: str | None = option(f"Where loops start: {INITIAL}", metavar="SET")
    target: str | None = as_in(LoopTexts, "target")
    tolerance: float | None = as_in(LoopTexts, "tolerance")
    avoid: str | None = as_in(ControllerTexts, "avoid")
    rate: float | None = as_in(LoopTexts, "rate")
    model: str | None = as_in(LoopTexts, "model")
    parameter: list[str] | None = as_in(LoopTexts, "parameter")
    exogenous: list[str] | None = as_in(LoopTexts, "exogenous")
    noise: str | None = option(
        "Bound on the error of the measured states at every sample, one for all states or "
        "one for each. It is no standard deviation, unlike --noise of simulate and verify.",
        metavar="E[,E..]",
    )
    delay: str | None = as_in(LoopTexts, "delay")
    min_dwell: MinDwell = None
    counts: str | None = option(
        "Cells of the proof along each axis [default: chosen for the policy].", metavar="C[,C..]"
    )
    seconds: float | None = option("Stop after this time [s]. What is proved by then stays proved.")
    output: str | None = option(
        "Picture of what is proved: a .png, .svg or .pdf file.", "--output", "-o", metavar="FILE"
    )
    certificate: str | None = option(
        "File of the proof, which capsyn check checks.", metavar="FILE"
    )
    require_arrival: float | None = option(
        "Least share of the starts that must be proved to arrive.", metavar="SHARE"
    )
    require_staying: float | None = option(
        "Least share of the starts that must be proved to stay.", metavar="SHARE"
    )
    save: bool = option("Keep the certificate in the policy's file.", "--save", default=False)
    seed: Seed = 0
    threads: Threads = None


@flat
def certify(file: File, options: CertifyOptions, as_json: Json = False) -> None:
    """Prove what the sampled loop of a policy does from a set of starts.

    The proof says that the loop arrives, stays for ever, or avoids a set. Ctrl-C ends the search
    and keeps what is proved. The exit status is 1 if a stated requirement is not met.
    """
    from capsyn.certification.certify import certify
    from capsyn.plots.certificate import save_certificate_plot
    from capsyn.policies.policy import Policy

    _check(file, options)
    policy = Policy.load(file)
    given = _arguments(policy, options)
    with working("proving"), lasting():
        certificate = _with_replays(certify(policy, **given), file, policy.domain.n, options, given)
    if options.output is not None:
        save_certificate_plot(certificate, policy.name, options.output)
    if options.certificate is not None:
        certificate.save(options.certificate)
    if options.save:
        policy.with_evidence(certificate=certificate.evidence()).save(file)
    data, missed = certificate.to_json(), _missed(certificate, options)
    written = [path for path in (options.output, options.certificate) if path is not None]
    end = f"wrote {' and '.join(written)}" if written else None
    show(as_json, data | {"missed": missed}, lambda: print_certificate(data), end)
    for line in missed:
        typer.echo(line, err=True)
    if missed:
        raise typer.Exit(1)


def _check(file: str, options: CertifyOptions) -> None:
    """Raise `ProblemError` where a requirement is no share, or something cannot be written."""
    from capsyn.execution.files import check_writable
    from capsyn.plots.figure import check_format

    for name in REQUIREMENTS:
        least = getattr(options, f"require_{name}")
        if least is not None and not 0 <= least <= 1:
            raise ProblemError(f"--require-{name} must be between 0 and 1; got {least:g}")
    if options.output is not None:
        check_format(options.output)
    for path in (options.output, options.certificate, file if options.save else None):
        if path is not None:
            check_writable(path)


def _arguments(policy: Any, options: CertifyOptions) -> dict[str, Any]:
    """Return the arguments of `capsyn.certify` that options mean; what is None is left out."""
    if ":" in (options.delay or ""):
        raise ProblemError("--delay must be one value here; ranges are for verify")
    if ":" in (options.noise or ""):
        raise ProblemError("--noise must be a bound E, or one of each state, here; see --help")
    given = sampled_options(policy, options, _value_or_range)
    if options.initial is not None:
        given["initial"] = starts(options.initial, policy.domain.names)
    if options.avoid is not None:
        given["avoid"] = region_or_function("--avoid", options.avoid, policy.space.names)
    if options.noise is not None:
        given["noise"] = one_or_list("--noise", options.noise)
    if options.counts is not None:
        given["counts"] = whole_number_list("--counts", options.counts)
    if options.seconds is not None:
        given["seconds"] = options.seconds
    return given


def _value_or_range(name: str, text: str) -> Any:
    """Return the number of a text, or the pair of LOW:HIGH."""
    low, colon, high = text.partition(":")
    if not colon:
        return number(name, text)
    pair = (number(name, low), number(name, high))
    if pair[0] > pair[1]:
        raise ProblemError(f"`{name}` must be a value or a range LOW:HIGH; got '{text}'")
    return pair


def _with_replays(
    certificate: Certificate, file: str, states: int, options: CertifyOptions, given: dict[str, Any]
) -> Certificate:
    """Return the certificate with the command that simulates each of its refuted starts.

    Unless it has them. They are of the middle of each range.
    """
    if certificate.replays:
        return certificate
    names = "rate model target tolerance delay min_dwell".split()
    values = {option_name(name): getattr(options, name) for name in names}
    start: dict[str, Any] = dict.fromkeys(["delay", "disturbance", "noise"], [])
    for kind in ("parameters", "exogenous"):
        start[kind] = {name: _middle(value) for name, value in given.get(kind, {}).items()}
    names = certificate.cells.domain.names
    lines = []
    for row in certificate.refuted.tolist():  # after the states what they were told
        told = dict(zip(names[states:], row[states:])) or start["exogenous"]
        lines.append(
            simulate_line(file, start | {"initial": row[:states], "exogenous": told}, values)
        )
    return dataclasses.replace(certificate, replays=tuple(lines))


def _middle(value: Any) -> Any:
    return sum(value) / 2 if isinstance(value, tuple) else value


def _missed(certificate: Certificate, options: CertifyOptions) -> list[str]:
    """Return a sentence for each requirement that is not met."""
    shares = {name: getattr(certificate, name) for name in REQUIREMENTS}
    asked = {name: getattr(options, f"require_{name}") for name in REQUIREMENTS}
    return [
        f"--require-{name} {asked[name]:g} is not met: {share:.6g}"
        for name, share in shares.items()
        if asked[name] is not None and share < asked[name]
    ]


def check(
    certificate: Annotated[
        str,
        typer.Argument(
            metavar="CERTIFICATE", help="A file that capsyn certify --certificate wrote."
        ),
    ],
    policy: Annotated[
        str, typer.Argument(metavar="POLICY", help="The policy file that the proof is about.")
    ],
    as_json: Json = False,
) -> None:
    """Check a proof cell by cell, with arithmetic of its own.

    The exit status is 1 if the proof is refused.
    """
    from capsyn.certification.check import check
    from capsyn.policies.policy import Policy

    loaded = Policy.load(policy)
    try:
        with working("checking"):
            found = check(certificate, loaded)
    except CertificateError as error:
        reason = " ".join(str(error).split())
        show(as_json, {"holds": False, "reason": reason}, lambda: None)
        typer.echo(f"refused: {reason}", err=True)
        raise typer.Exit(1) from None
    data = {"holds": True, "cells": found.cells, "seconds": found.seconds}
    told = f"holds for {policy}: {found.cells:,} cells checked in {found.seconds:.3g} s"
    show(as_json, data, lambda: print_line("certificate", told))
