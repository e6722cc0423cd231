"""Commands that make the paper's policies, figures and numbers."""

from __future__ import annotations

from typing import Annotated

import typer

from capsyn.cli.console import print_table, show, working
from capsyn.cli.options import Backend, Json, Threads


def bench(
    backend: Backend = "auto",
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Make the paper's six policies, and show their solves and times beside the paper's."""
    from capsyn.paper.cases import count_solves

    rows = count_solves(backend=backend, threads=threads)
    show(as_json, rows, lambda: print_table(rows))


def reproduce(
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="DIR", help="Folder for the results.")
    ],
    trials: Annotated[
        int, typer.Option(help="Number of Monte Carlo trials of each policy.")
    ] = 1000,
    threads: Threads = None,
) -> None:
    """Make the paper's figures and numbers, and capsyn's own."""
    from capsyn.paper.reproduction import reproduce as run

    with working("starting") as tell:
        paths = run(output, trials=trials, threads=threads, tell=tell)
    for path in paths:
        typer.echo(f"wrote {path}")
