"""What the command line prints: tables, reports, progress bars."""

from __future__ import annotations

import contextlib
import json
import logging
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from capsyn.subdivision.lattice_points import Progress


def show_all(stream: Any) -> None:
    """Let a stream write what its encoding lacks as an escape, as theta on a Windows console."""
    if getattr(stream, "errors", None) == "strict":  # an in-memory stream may have none
        stream.reconfigure(errors="backslashreplace")


def show(as_json: bool, data: Any, text: Callable[[], None], end: str | None = None) -> None:
    """Print data as JSON, or call what prints it as text, and print a last line."""
    if as_json:
        typer.echo(json.dumps(data, indent=2))
        return
    text()
    if end is not None:
        typer.echo(end)


@contextlib.contextmanager
def progress_bars() -> Iterator[Callable[[Progress], None] | None]:
    """Yield a callback that draws a progress bar per level; None unless on a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("level {task.fields[level]}"),
        BarColumn(),
        TextColumn("{task.completed:,}/{task.total:,} solves"),
        TextColumn("{task.fields[cells]:,} cells"),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[tuple[int, int], Any] = {}

        def progress(now: Progress) -> None:
            key = (now.level, now.solves)
            if key not in tasks:
                tasks[key] = bars.add_task(
                    "",
                    total=now.solves,
                    level=f"{now.level}/{now.max_level}",
                    cells=now.cells,
                    rate="",
                )
            task = bars.tasks[tasks[key]]
            rate = task.finished_speed or task.speed
            shown = f"{rate:,.0f}/s" if rate else ""
            bars.update(tasks[key], completed=now.solved, rate=shown)

        yield progress


@contextlib.contextmanager
def notes(logger: str) -> Iterator[None]:
    """Print on stderr what a module logs as information, for a while."""
    log, handler = logging.getLogger(logger), logging.StreamHandler(sys.stderr)
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.setLevel(level)
        log.removeHandler(handler)


@contextlib.contextmanager
def working(text: str) -> Iterator[Callable[[str], None]]:
    """Say on a terminal what is being done, and for how long; yield what changes the text."""
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(text, total=None)
        yield lambda text: bars.update(task, description=text)


def print_table(rows: list[dict[str, Any]]) -> None:
    """Print rows of the same keys as a table."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for key in rows[0]:
        numbers = [row[key] for row in rows if row[key] is not None]
        right = all(isinstance(n, (int, float)) and not isinstance(n, bool) for n in numbers)
        table.add_column(key.replace("_", " "), justify="right" if right else "left")
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def _text(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "", True: "yes", False: "no"}[value]
    if isinstance(value, float):
        return f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def print_line(name: str, value: str) -> None:
    """Print what a value is called, and the value, in columns."""
    typer.echo(f"{name:<13}{value}")
