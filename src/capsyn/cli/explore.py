"""The command that writes the page of a policy."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from capsyn.cli.console import working
from capsyn.cli.options import File
from capsyn.errors import ProblemError


def explore(
    file: File,
    output: Annotated[str, typer.Option("--output", "-o", metavar="HTML", help="Where; one file.")],
    drawing: Annotated[
        str | None,
        typer.Option(
            help="pendulum, cart-pole, double-tank or none [default: by the problem's name]."
        ),
    ] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
) -> None:
    """Write a page where one sees the policy and watches it work."""
    from capsyn.execution.files import check_writable
    from capsyn.explorer.explore import explore
    from capsyn.policies.policy import Policy

    check_writable(output)
    if os.path.exists(output) and os.path.samefile(file, output):
        raise ProblemError(f"`--output` must be another file than the policy's; got '{output}'")
    policy = Policy.load(file)
    with working("drawing the page"):
        path = explore(policy, output, drawing)
    typer.echo(f"wrote {path} ({path.stat().st_size:,} bytes)")
    if open_page:
        import webbrowser

        if not webbrowser.open(path.resolve().as_uri()):
            typer.echo("there is no browser to open it with")
