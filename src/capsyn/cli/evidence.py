"""The commands that give evidence for a policy."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from capsyn.cli.better.optimum import compare_with_optimum, print_optimum
from capsyn.cli.console import show, working
from capsyn.cli.loop import ControllerTexts, controller_of, loop_options, tracked
from capsyn.cli.options import (
    INITIAL,
    Dask,
    File,
    Json,
    executor,
    flat,
    number_or_range,
    one_or_list,
    option,
    option_name,
    starts,
)
from capsyn.cli.printed import print_agreement, print_lyapunov
from capsyn.cli.problem_finder import given_source
from capsyn.cli.proofs.trials import print_monte_carlo
from capsyn.errors import ProblemError
from capsyn.verification.sentences import headlines, simulate_line

if TYPE_CHECKING:
    from capsyn.policies.policy import Policy


@dataclass(frozen=True)
class VerifyOptions(ControllerTexts):
    """Options of ``capsyn verify``."""

    monte_carlo: int | None = option(
        "Run this number of trials from random initial states.", metavar="N", before="duration"
    )
    duration: float | None = option(
        "Time limit of a trial [time unit of the model, as all times] [default: 20]."
    )
    initial: str | None = option(f"Where loops start: {INITIAL}", metavar="SET", before="target")
    within: float | None = option(
        "Time within which a trial must arrive [time unit].", before="model"
    )
    hold: float | None = option(
        "Time at the end for which a trial must stay in the target [time unit] [default: 0].",
        before="model",
    )
    lyapunov: str | None = option(
        "A function V of x (and w) whose decrease is to be proved.",
        metavar="FILE.py:V",
        before="seed",
    )
    depth: int | None = option(
        "Most bisections of a cell in the proof [default: 12].", before="seed"
    )
    grid: str | None = option(
        "Spacing of a grid on which the sign of dV/dt is computed.",
        metavar="H[,H..]",
        before="seed",
    )
    agreement: int | None = option(
        "Compare the policy with the controller that it came from, at this number of random "
        "states.",
        metavar="N",
        before="seed",
    )
    source: str | None = option(
        "The controller that the policy came from, if its file does not tell it: a function "
        "from states to symbols, or an agent with predict.",
        metavar="FILE.py:NAME",
        before="seed",
    )
    steps: int | None = option(
        "Steps of sSAC over the horizon for --agreement. More steps than the policy's own "
        "show what its own steps hide.",
        before="seed",
    )
    optimum: int | None = option(
        "Compare this number of closed loops with the best loops that the symbols allow. "
        "The default of --duration is then 10 horizons.",
        metavar="N",
        before="seed",
    )
    counts: str | None = option(
        "Intervals of the optimum's grid [default: 400 in two dimensions].",
        metavar="C[,C..]",
        before="seed",
    )
    control_weight: float | None = option(
        "Weight R of an effort u^T R u that is added to the optimum's costs.",
        metavar="R",
        before="seed",
    )
    memory: str | None = option(
        "Most memory that the grid may take, as 2GB [default: half of the available memory].",
        metavar="BYTES",
        before="seed",
    )
    output: str | None = option(
        "Picture of where the policy costs more than the optimum: a .png, .svg or .pdf file.",
        "--output",
        "-o",
        metavar="FILE",
        before="seed",
    )
    confidence: float = option("Confidence of the intervals.", default=0.95, before="seed")
    require_success: float | None = option(
        "Least share of trials that must succeed.", before="seed"
    )
    require_proved: float | None = option(
        "Least share of the volume on which the decrease must be proved.", before="seed"
    )
    require_agreement: float | None = option("Least agreement that must be reached.", before="seed")
    require_optimality: float | None = option(
        "Least ratio of the optimum's cost to the policy's cost.", before="seed"
    )
    save: bool = option(
        "Keep the evidence in the policy's file.", "--save", default=False, before="seed"
    )
    dask: Dask = None


@dataclass(frozen=True)
class Kind:
    """A kind of evidence that ``capsyn verify`` gives."""

    name: str  # field of `VerifyOptions` that asks for it, and its name in files and JSON
    requirement: str  # field that states the least value of its figure
    figure: str
    own: tuple[str, ...]  # fields that need it
    doing: str  # what is said while it is looked for
    find: Callable[[Policy, VerifyOptions, Any], dict[str, Any]]  # gives it as plain data
    show: Callable[[dict[str, Any], str, str, VerifyOptions], None]  # (data, sentence, file, ..)


def _try_out(policy: Policy, options: VerifyOptions, client: Any) -> dict[str, Any]:
    from capsyn.verification.monte_carlo import try_out
    from capsyn.verification.trials import TrialOptions

    controller = controller_of(policy, options)
    loop = loop_options(policy, options, one=number_or_range, each=number_or_range, executor=client)
    trials = TrialOptions(
        loop,
        options.monte_carlo or 0,
        initial=starts(options.initial, policy.domain.names),
        within=options.within,
        hold=options.hold or 0.0,
        confidence=options.confidence,
        track=tracked(options.track),
    )
    return try_out(controller, trials).to_json()


def _show_trials(data: dict[str, Any], sentence: str, file: str, options: VerifyOptions) -> None:
    """Print what came of trials, and the command that repeats the first that failed."""
    repeated = (
        "duration rate model min_dwell outside outside_at_once target tolerance avoid stay_in cost "
        "track online background"
    ).split()
    values = {option_name(name): getattr(options, name) for name in repeated}
    values["--no-outside-at-once"] = options.outside_at_once is False
    values["--stop-at-target"] = not options.hold
    failing = data["failing_trials"]
    if options.delay is not None and failing and not failing[0]["delay"]:
        values["--delay"] = 0  # that of the policy may be another
    print_monte_carlo(data, sentence, simulate_line(file, failing[0], values) if failing else None)


def _prove(policy: Policy, options: VerifyOptions, client: Any) -> dict[str, Any]:
    from capsyn.cli.problem_finder import find_function
    from capsyn.verification.lyapunov import lyapunov, lyapunov_grid

    V = find_function(options.lyapunov or "")
    proof = lyapunov(policy, V, depth=12 if options.depth is None else options.depth).to_json()
    proof["function"] = options.lyapunov
    if options.grid is not None:
        proof["grid"] = lyapunov_grid(policy, V, one_or_list("--grid", options.grid)).to_json()
    return proof


def _comparable(policy: Policy, options: VerifyOptions) -> bool:
    """Return whether there is a controller to compare a policy with."""
    from capsyn.sources.finite_control_set import source_of

    own = None not in (policy.model, policy.horizon, policy.settings)
    return own or options.source is not None or source_of(policy) is not None


def _compare(policy: Policy, options: VerifyOptions, client: Any) -> dict[str, Any]:
    from capsyn.verification.agreement import agreement

    return agreement(
        policy,
        options.agreement or 0,
        controller=given_source(policy, options.source),
        seed=options.seed,
        confidence=options.confidence,
        steps=options.steps,
        backend=options.backend,
        threads=options.threads,
    ).to_json()


KINDS = (
    Kind(
        "monte_carlo",
        "require_success",
        "success_rate",
        tuple(
            "rate initial target tolerance within hold duration model parameter disturbance noise "
            "delay min_dwell outside outside_at_once online background exogenous track dask avoid "
            "stay_in cost".split()
        ),
        "Monte Carlo",
        _try_out,
        _show_trials,
    ),
    Kind(
        "lyapunov",
        "require_proved",
        "proved",
        ("depth", "grid"),
        "proving dV/dt <= 0",
        _prove,
        lambda data, sentence, *_: print_lyapunov(data, sentence),
    ),
    Kind(
        "agreement",
        "require_agreement",
        "share",
        ("steps", "source"),
        "comparing with the controller",
        _compare,
        lambda data, sentence, *_: print_agreement(data, sentence),
    ),
    Kind(
        "optimum",
        "require_optimality",
        "optimality",
        tuple(
            "rate initial duration outside exogenous counts control_weight memory output".split()
        ),
        "looking for the optimum",
        compare_with_optimum,
        print_optimum,
    ),
)
"""All kinds of evidence, in the order in which they are looked for and printed."""


@flat
def verify(file: File, options: VerifyOptions, as_json: Json = False) -> None:
    """Give evidence for a policy.

    Without a kind: Monte Carlo and agreement, as far as the file allows. The exit status is 1 when
    a stated requirement is not met.
    """
    from capsyn.execution.files import check_writable
    from capsyn.policies.policy import Policy

    if options.save:
        check_writable(file)
    policy = Policy.load(file)
    options = _with_kinds(policy, options)
    kinds = [kind for kind in KINDS if getattr(options, kind.name) is not None]
    if options.agreement is not None and not _comparable(policy, options):
        raise ProblemError(
            f"--agreement needs a policy with its model, horizon and settings, which '{file}' "
            "has not, or the controller that it came from: --source FILE.py:NAME"
        )
    _check_requirements(options)
    _check_owners(options)
    if options.save and options.online is not None:
        raise ProblemError("--save keeps evidence of the policy itself: not with --online")
    evidence: dict[str, Any] = {}
    with executor(options.dask) as client, working("loading") as tell:
        for kind in kinds:
            tell(kind.doing)
            evidence[kind.name] = kind.find(policy, options, client)
    missed = _missed(options, evidence)
    if options.save:
        policy.with_evidence(**evidence).save(file)
    sentences = list(headlines(evidence).values())

    def print_kinds() -> None:
        for kind, sentence in zip(kinds, sentences, strict=True):
            kind.show(evidence[kind.name], sentence, file, options)

    show(as_json, evidence | {"missed": missed}, print_kinds)
    for line in missed:
        typer.echo(line, err=True)
    if missed:
        raise typer.Exit(1)


def _with_kinds(policy: Policy, options: VerifyOptions) -> VerifyOptions:
    """Return options that ask for a kind of evidence: the usual ones where they ask for none."""
    if any(getattr(options, kind.name) is not None for kind in KINDS):
        return options
    trials = 1000 if policy.target is not None or options.target is not None else None
    states = 100_000 if _comparable(policy, options) else None
    if trials is None and states is None:
        raise ProblemError("the policy has neither target nor model: nothing can be verified")
    return dataclasses.replace(options, monte_carlo=trials, agreement=states)


def _check_requirements(options: VerifyOptions) -> None:
    """Raise `ProblemError` where a requirement is no share, or of a kind that is not asked for."""
    for kind in KINDS:
        least, option = getattr(options, kind.requirement), option_name(kind.requirement)
        if least is not None and not 0 <= least <= 1:
            raise ProblemError(f"{option} must be between 0 and 1; got {least:g}")
        if least is not None and getattr(options, kind.name) is None:
            raise ProblemError(f"{option} needs {option_name(kind.name)}")


def _check_owners(options: VerifyOptions) -> None:
    """Raise `ProblemError` where an option is of kinds none of which is asked for."""
    for name in dict.fromkeys(name for kind in KINDS for name in kind.own):
        owners = [kind.name for kind in KINDS if name in kind.own]
        if getattr(options, name) and all(getattr(options, owner) is None for owner in owners):
            needed = " or ".join(map(option_name, owners))
            raise ProblemError(f"{option_name(name)} needs {needed}")


def _missed(options: VerifyOptions, evidence: dict[str, Any]) -> list[str]:
    """Return a sentence for each requirement that the evidence does not meet."""
    sentences = []
    for kind in KINDS:
        least = getattr(options, kind.requirement)
        if least is None:
            continue
        data = evidence[kind.name]
        asked = f"{option_name(kind.requirement)} {least:g} is not met"
        if not data.get("bound", True):
            sentences.append(f"{asked}: the optimum is no bound")
        elif (share := data[kind.figure]) < least:
            sentences.append(f"{asked}: {share:.6g}")
    return sentences
