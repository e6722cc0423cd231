"""The commands that look into a policy: at a state, at exogenous inputs, and in a page."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated

import typer

from capsyn.cli.console import show, working
from capsyn.cli.options import Current, File, Json, Outside, assignments, number
from capsyn.errors import ProblemError
from capsyn.modelling.exogenous import beyond_text

SAYS_NONE = ", for the policy says no sample time"
"""What is told of the rate of a page that is of no policy's own."""

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capsyn.policies.policy import Policy


def query(
    file: File,
    state: Annotated[
        list[str],
        typer.Argument(
            metavar="X1 X2 .. W1 ..", help="A state, then the exogenous inputs if there are any."
        ),
    ],
    outside: Outside = None,
    current: Current = None,
    as_json: Json = False,
) -> None:
    """Look up the symbol of a state, and of exogenous inputs if there are any."""
    from capsyn.policies.policy import Policy

    policy = Policy.load(file)
    names, n = policy.space.names, policy.domain.n
    if len(state) != len(names):
        what = "the state" if n == len(names) else "the state and the exogenous inputs"
        raise ProblemError(
            f"{what} must be {len(names)} number(s) ({', '.join(names)}); got {len(state)}"
        )
    values = [number(name, text) for name, text in zip(names, state)]
    symbol = int(policy(values, outside=outside, current=current))
    control, own_name = policy.controls[symbol].tolist(), policy.symbol_name(symbol)
    told = {} if policy.exogenous is None else {"exogenous": values[n:]}
    found = {"symbol": symbol, "name": own_name, "control": control}
    left = _outside(policy, values)
    data = {"state": values[:n], **told, **found, **({"outside": left} if left else {})}
    pairs = [
        f"{name} = {value:g} {unit}".rstrip()
        for name, value, unit in zip(policy.alphabet.inputs, control, policy.alphabet.units)
    ]
    text = f"symbol {symbol} '{own_name}': {', '.join(pairs)}"
    if policy.kept is not None:
        data["keeps_limits"] = kept = bool(policy.keeps_limits(values, current=current))
        text += f"\nlimits are {'kept' if kept else 'not kept'} from there"
    end = f"outside: {left}" if left else None
    show(as_json, data, lambda: typer.echo(text), end)


def _outside(policy: Policy, values: Sequence[float]) -> str | None:
    """Return what of a reading is outside; None where the policy has a symbol."""
    if policy.covers(values):
        return None
    return beyond_text(policy.space, values, values) or "in a gap"


def at(
    file: File,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="The new policy file, whose policy takes states alone.",
        ),
    ],
    exogenous: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=W",
            help="The constant value of an exogenous input. Give it once for each input.",
        ),
    ],
) -> None:
    """Write the policy that is left where exogenous inputs never change."""
    from capsyn.execution.files import check_writable
    from capsyn.policies.policy import Policy

    check_writable(output)
    texts = assignments("--exogenous", exogenous)
    values = {name: number(f"exogenous {name}", text) for name, text in texts.items()}
    fixed = Policy.load(file).at(values)
    fixed.save(output)
    typer.echo(f"wrote {output}: {fixed!r}")


def explore(
    file: File,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="HTML", help="The file of the page.")
    ],
    drawing: Annotated[
        str | None,
        typer.Option(
            help="Animation: pendulum, cart-pole, double-tank or none [default: by the problem's "
            "name]."
        ),
    ] = None,
    open_page: Annotated[
        bool, typer.Option("--open", help="Open the page in the browser.")
    ] = False,
) -> None:
    """Write a page where one sees the policy and watches it work."""
    from capsyn.execution.files import check_writable
    from capsyn.explorer.explore import explore
    from capsyn.explorer.policy_data import page_rate
    from capsyn.policies.policy import Policy

    check_writable(output)
    if os.path.exists(output) and os.path.samefile(file, output):
        raise ProblemError(f"`--output` must be another file than the policy's; got '{output}'")
    policy = Policy.load(file)
    with working("drawing the page"):
        path = explore(policy, output, drawing)
    rate, unit = page_rate(policy), policy.time_unit
    sampled = f"sampled every {1 / rate:g} {unit}" + ("" if policy.settings else SAYS_NONE)
    typer.echo(
        f"wrote {path} ({path.stat().st_size:,} bytes)" + (f", {sampled}" if policy.model else "")
    )
    if open_page:
        import webbrowser

        if not webbrowser.open(path.resolve().as_uri()):
            typer.echo("there is no browser to open it with")
