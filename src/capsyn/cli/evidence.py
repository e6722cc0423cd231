"""Commands that try a policy out: simulate, verify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsyn.cli.console import show, working
from capsyn.cli.options import (
    Backend,
    Background,
    Dask,
    Delay,
    Disturbance,
    File,
    Json,
    MinDwell,
    ModelOption,
    Noise,
    Online,
    Outside,
    Parameters,
    Rate,
    Seed,
    Target,
    Threads,
    assignments,
    executor,
    number,
    number_list,
    number_or_range,
    one_or_list,
    region,
)
from capsyn.cli.printed import print_evidence
from capsyn.errors import ProblemError
from capsyn.verification.sentences import simulate_line

if TYPE_CHECKING:
    from capsyn.policies.policy import Policy

_REPEATED = (
    "--duration --rate --model --min-dwell --outside --target --tolerance --online --background"
).split()
"""Options by which ``capsyn simulate`` repeats a trial of ``capsyn verify``."""


def simulate(
    file: File,
    x0: Annotated[
        list[str] | None,
        typer.Option(metavar="X[,X..]", help="Initial state; may be repeated [default: random]."),
    ] = None,
    duration: Annotated[float, typer.Option(help="Seconds to simulate.")] = 20.0,
    rate: Rate = None,
    output: Annotated[
        str | None,
        typer.Option("--output", "-o", metavar="FILE", help=".csv, .json, .png, .pdf or .svg."),
    ] = None,
    target: Target = None,
    tolerance: Annotated[float | None, typer.Option(help="Radius of the target.")] = None,
    stop_at_target: Annotated[bool, typer.Option(help="End where the target is reached.")] = False,
    model: ModelOption = None,
    parameter: Parameters = None,
    disturbance: Disturbance = None,
    noise: Noise = None,
    delay: Delay = None,
    min_dwell: MinDwell = None,
    outside: Outside = None,
    online: Online = None,
    background: Background = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Simulate the closed loop of a policy."""
    import numpy as np

    from capsyn.execution.files import check_writable
    from capsyn.plots.figure import FORMATS
    from capsyn.plots.trajectory import save_trajectory_plot
    from capsyn.policies.policy import Policy
    from capsyn.simulation.simulate import simulate as run
    from capsyn.validation import whole_number

    kind = "" if output is None else Path(output).suffix.lstrip(".").lower()
    if output is not None:
        if kind not in ("csv", "json", *FORMATS):
            endings = ", ".join(f".{ending}" for ending in ("csv", "json", *FORMATS))
            raise ProblemError(f"the output must end in {endings}; got '{output}'")
        check_writable(output)
    seed = whole_number("--seed", seed, least=0)
    policy = Policy.load(file)
    states = [number_list("--x0", text) for text in x0] if x0 else policy.domain.sample(1, seed)
    if len({len(state) for state in states} | {policy.domain.n}) > 1:
        names = ", ".join(policy.domain.names)
        raise ProblemError(f"--x0 must be {policy.domain.n} number(s) ({names}); got {x0}")
    ranges = [
        name
        for name, text in (("--noise", noise), ("--delay", delay), ("--disturbance", disturbance))
        if text and ":" in text
    ]
    if ranges:
        raise ProblemError(f"{ranges[0]} must be one value here; ranges are for verify")
    with working("simulating"):
        trajectory = run(
            _controller(policy, online, background, backend),
            np.array(states)[0] if len(states) == 1 else np.array(states),
            duration,
            rate,
            model=_model(model),
            parameters={
                name: number(name, text)
                for name, text in assignments("--parameter", parameter or []).items()
            },
            disturbance=None if disturbance is None else one_or_list("--disturbance", disturbance),
            noise=None if noise is None else one_or_list("--noise", noise),
            delay=0.0 if delay is None else number("--delay", delay),
            min_dwell=min_dwell,
            outside=outside,
            target=_target(policy, target, tolerance),
            stop_at_target=stop_at_target,
            seed=seed,
            backend=backend,
            threads=threads,
        )
    if output is not None:
        if kind in FORMATS:
            save_trajectory_plot(trajectory, output)
        else:
            trajectory.save(output)
    rows = trajectory.summary()

    def told() -> None:
        for row in rows:
            typer.echo(_sentence(row))
        if output is not None:
            typer.echo(f"wrote {output}")

    show(as_json, rows if len(rows) > 1 else rows[0], told)


def _sentence(row: dict[str, Any]) -> str:
    def state(values: list[float | None]) -> str:
        return "(" + ", ".join("nan" if v is None else f"{v:g}" for v in values) + ")"

    reached = "" if row["arrived"] is None else f"; in the target first at {row['arrived']:g} s"
    lost = f"; {row['outside']:,} samples outside the domain" if row["outside"] else ""
    cost = "not finite" if row["cost"] is None else f"{row['cost']:.6g}"
    return (
        f"from {state(row['initial'])} to {state(row['final'])} in {row['duration']:g} s, ended: "
        f"{row['ended']}; {row['switches']:,} switches, cost {cost}{reached}{lost}"
    )


def verify(
    file: File,
    monte_carlo: Annotated[
        int | None, typer.Option(metavar="N", help="Trials from random initial states.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Time limit of a trial [s] [default: 20].")
    ] = None,
    rate: Rate = None,
    initial: Annotated[
        str | None,
        typer.Option(metavar="SET", help="NAME=LOW:HIGH[,..] [default: the domain]."),
    ] = None,
    target: Target = None,
    tolerance: Annotated[float | None, typer.Option(help="Radius of the target.")] = None,
    within: Annotated[float | None, typer.Option(help="Time to arrive in [s].")] = None,
    hold: Annotated[
        float | None, typer.Option(help="Time at the end to stay there [s] [default: 0].")
    ] = None,
    model: ModelOption = None,
    parameter: Parameters = None,
    disturbance: Disturbance = None,
    noise: Noise = None,
    delay: Delay = None,
    min_dwell: MinDwell = None,
    outside: Outside = None,
    online: Online = None,
    background: Background = False,
    lyapunov: Annotated[
        str | None,
        typer.Option(metavar="FILE.py:V", help="A function V of x whose decrease is proved."),
    ] = None,
    depth: Annotated[
        int | None, typer.Option(help="Bisections of a cell in the proof [default: 12].")
    ] = None,
    grid: Annotated[
        str | None, typer.Option(metavar="H[,H..]", help="Spacing of a grid of signs of dV/dt.")
    ] = None,
    agreement: Annotated[
        int | None, typer.Option(metavar="N", help="Random states to compare with sSAC.")
    ] = None,
    confidence: Annotated[float, typer.Option(help="Of the intervals.")] = 0.95,
    require_success: Annotated[float | None, typer.Option(help="Least share of successes.")] = None,
    require_proved: Annotated[float | None, typer.Option(help="Least share proved.")] = None,
    require_agreement: Annotated[float | None, typer.Option(help="Least agreement.")] = None,
    save: Annotated[bool, typer.Option("--save", help="Keep the evidence in the file.")] = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    threads: Threads = None,
    dask: Dask = None,
    as_json: Json = False,
) -> None:
    """Give evidence for a policy.

    Without a kind: Monte Carlo and agreement, as far as the file allows. The exit status is 1 when
    a stated requirement is not met.
    """
    from capsyn.execution.files import check_writable
    from capsyn.policies.policy import Policy

    if save:
        check_writable(file)
    policy = Policy.load(file)
    if monte_carlo is None and lyapunov is None and agreement is None:
        monte_carlo = 1000 if policy.target is not None or target is not None else None
        agreement = 100_000 if policy.settings is not None and policy.model is not None else None
        if monte_carlo is None and agreement is None:
            raise ProblemError("the policy has neither target nor model: nothing can be verified")
    if agreement is not None and (policy.settings is None or policy.model is None):
        raise ProblemError(
            f"--agreement needs a policy with its model and settings, which '{file}' has not; in "
            "Python capsyn.agreement(policy, controller=function) compares it with a function"
        )
    requirements = (
        ("--require-success", require_success, "monte_carlo", monte_carlo, "success_rate"),
        ("--require-proved", require_proved, "lyapunov", lyapunov, "proved"),
        ("--require-agreement", require_agreement, "agreement", agreement, "share"),
    )
    for option, wanted, kind, asked, _ in requirements:
        if wanted is not None and not 0 <= wanted <= 1:
            raise ProblemError(f"{option} must be between 0 and 1; got {wanted:g}")
        if wanted is not None and asked is None:
            raise ProblemError(f"{option} needs --{kind.replace('_', '-')}")
    for_trials = {
        "--rate": rate,
        "--initial": initial,
        "--target": target,
        "--tolerance": tolerance,
        "--within": within,
        "--hold": hold,
        "--duration": duration,
        "--model": model,
        "--parameter": parameter,
        "--disturbance": disturbance,
        "--noise": noise,
        "--delay": delay,
        "--min-dwell": min_dwell,
        "--outside": outside,
        "--online": online,
        "--background": background,
        "--dask": dask,
    }
    _needs("--monte-carlo", monte_carlo, for_trials)
    _needs("--lyapunov", lyapunov, {"--depth": depth, "--grid": grid})
    if save and online is not None:
        raise ProblemError("--save keeps evidence of the policy itself: not with --online")
    found: dict[str, Any] = {}
    with executor(dask) as client, working("loading") as tell:
        if monte_carlo is not None:
            from capsyn.verification.monte_carlo import monte_carlo as try_out

            tell("Monte Carlo")
            found["monte_carlo"] = try_out(
                _controller(policy, online, background, backend),
                monte_carlo,
                duration=20.0 if duration is None else duration,
                rate=rate,
                initial=None
                if initial is None
                else region("--initial", initial, policy.domain.names),
                target=_target(policy, target, tolerance),
                within=within,
                hold=hold or 0.0,
                model=_model(model),
                parameters={
                    name: number_or_range(name, text)
                    for name, text in assignments("--parameter", parameter or []).items()
                },
                disturbance=number_or_range("--disturbance", disturbance),
                noise=number_or_range("--noise", noise),
                delay=number_or_range("--delay", delay or "0"),
                min_dwell=min_dwell,
                outside=outside,
                seed=seed,
                confidence=confidence,
                backend=backend,
                threads=threads,
                executor=client,
            ).to_json()
        if lyapunov is not None:
            tell("proving dV/dt <= 0")
            found["lyapunov"] = _prove(policy, lyapunov, depth, grid)
        if agreement is not None:
            from capsyn.verification.agreement import agreement as compare

            tell("comparing with sSAC")
            found["agreement"] = compare(
                policy,
                agreement,
                seed=seed,
                confidence=confidence,
                backend=backend,
                threads=threads,
            ).to_json()
    missed = [
        f"{option} {wanted:g} is not met: {found[kind][figure]:.6g}"
        for option, wanted, kind, _, figure in requirements
        if wanted is not None and found[kind][figure] < wanted
    ]
    if save:
        policy.with_evidence(**found).save(file)
    failing = found.get("monte_carlo", {}).get("failing_trials")
    repeated = {name: for_trials[name] for name in _REPEATED} | {"--stop-at-target": not hold}
    again = simulate_line(file, failing[0], repeated) if failing else None
    show(as_json, found | {"missed": missed}, lambda: print_evidence(found, again))
    for sentence in missed:
        typer.echo(sentence, err=True)
    if missed:
        raise typer.Exit(1)


def _needs(option: str, value: Any, others: dict[str, Any]) -> None:
    """Raise `ProblemError` where options are given that need another one."""
    for other, given in others.items():
        if value is None and given:
            raise ProblemError(f"{other} needs {option}")


def _prove(policy: Policy, function: str, depth: int | None, grid: str | None) -> dict[str, Any]:
    from capsyn.cli.problem_finder import find_function
    from capsyn.verification.lyapunov import lyapunov, lyapunov_grid

    V = find_function(function)
    found = lyapunov(policy, V, depth=12 if depth is None else depth).to_json()
    found["function"] = function
    if grid is not None:
        found["grid"] = lyapunov_grid(policy, V, one_or_list("--grid", grid)).to_json()
    return found


def _controller(policy: Policy, online: str | None, background: bool, backend: str) -> Any:
    if online is None:
        if background:
            raise ProblemError("--background needs --online")
        return policy
    from capsyn.controllers.online import online_controller

    return online_controller(
        policy, online, default=policy if background else None, backend=backend
    )


def _model(text: str | None) -> Any:
    if text is None:
        return None
    from capsyn.cli.problem_finder import find_function, find_problem
    from capsyn.modelling.problem import Problem
    from capsyn.policies.policy import Policy

    place, _, name = text.rpartition(":")
    if name.isidentifier() and place:
        return find_function(text, (Problem,))
    return Policy.load(text) if text.endswith(".cap") else find_problem(text)


def _target(policy: Policy, text: str | None, tolerance: float | None) -> Any:
    from capsyn.cli.problem_finder import find_function
    from capsyn.modelling.targets import with_tolerance

    if text is None:
        return with_tolerance(policy.target, tolerance)
    if ".py:" in text or ("=" not in text and ":" in text):
        return with_tolerance(find_function(text), tolerance)
    return region("--target", text, policy.domain.names, tolerance)
