"""Emulated processors, and the longest of some calls on them."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capsyn.exports.c.language import literal
from capsyn.exports.c.sizes import run_tool
from capsyn.exports.c.timing.programs import AVR, CORTEX_M3, LINK, program
from capsyn.exports.plan import Files


@dataclass(frozen=True)
class Machine:
    """A processor that an emulator runs.

    Its programs are made of `parts`, built by a `compiler` with the options `link`, run by an
    `emulator`, and hold `room` bytes of inputs. What is counted is the `unit`.
    """

    chip: str
    unit: str
    parts: Mapping[str, str]
    compiler: tuple[str, ...]
    link: tuple[str, ...]
    emulator: tuple[str, ...]
    room: int

    @property
    def here(self) -> bool:
        """Whether its compiler and its emulator are installed."""
        return all(shutil.which(tool) for tool in (self.compiler[0], self.emulator[0]))


MACHINES = {
    "avr": Machine(
        "ATmega1284P",
        "cycles",
        AVR,
        ("avr-gcc", "-std=gnu99", "-mmcu=atmega1284p"),
        (),
        ("simavr", "-m", "atmega1284p", "-f", "16000000", "main.elf"),
        24 << 10,  # tables of both must lie in 64 kB
    ),
    "cortex-m3": Machine(
        "mps2-an385",
        "instructions",
        CORTEX_M3,
        ("arm-none-eabi-gcc", "-std=gnu99", "-mcpu=cortex-m3", "-mthumb", "-ffreestanding"),
        ("-nostdlib", "-T", "link.ld"),
        tuple(
            "qemu-system-arm -M mps2-an385 -display none -monitor none -serial none -icount shift=7"
            " -chardev stdio,id=out -semihosting-config enable=on,target=native,chardev=out"
            " -kernel main.elf".split()
        ),
        256 << 10,
    ),
}
"""Processors by name. The larger AVR runs what an ATmega328P does, in the same cycles."""


@dataclass(frozen=True)
class Longest:
    """The call that takes longest: its time [cycles or instructions], its row, its symbol."""

    time: int
    row: int
    symbol: int


def longest(
    machine: Machine,
    files: Files,
    prefix: str,
    asked: str,
    kind: str,
    given: np.ndarray,
    in_force: int | None = None,
) -> Longest | None:
    """Return the longest of some calls; None where the program cannot be built or does not end.

    Parameters
    ----------
    files : Files
        Header and source, called by `prefix`.
    asked : "symbol", "decide" or "next"
        The function.
    kind : str
        Type of its inputs.
    given : (K, n)
        Inputs of each call; integers, or finite numbers.
    in_force : int, optional
        The symbol in force, of functions that are asked for it.
    """
    most = None
    size = {"int16_t": 2, "int32_t": 4, "float": 4, "double": 8}[kind]
    batch = min(machine.room // (size * given.shape[1]), 1 << 15)
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        for file in (f"{prefix}.h", f"{prefix}.c"):
            (directory / file).write_bytes(files[file])
        (directory / "link.ld").write_text(LINK, encoding="utf-8")
        build = [*machine.compiler, "-Os", "-ffunction-sections", "-fdata-sections"]
        if run_tool([*build, "-c", f"{prefix}.c", "-o", "own.o"], directory) is None:
            return None
        link = [*build, "-Wl,--gc-sections", *machine.link, "main.c", "own.o", "-lgcc"]
        for begin in range(0, len(given), batch):
            rows = _literals(given[begin : begin + batch], kind)
            text = program(machine.parts, prefix, asked, kind, rows, in_force)
            (directory / "main.c").write_text(text, encoding="utf-8")
            if run_tool([*link, "-o", "main.elf"], directory) is None:
                return None
            said = run_tool([*machine.emulator], directory, subprocess.STDOUT)
            told = re.findall(r"[01]{32}", said or "")
            if len(told) != 3:
                return None
            time, at, symbol = (int(digits, 2) for digits in told)
            if most is None or time > most.time:
                most = Longest(time, begin + at, symbol)
    return most


def _literals(given: np.ndarray, kind: str) -> Sequence[Sequence[str]]:
    if kind in ("float", "double"):
        return [[literal(value, kind) for value in row] for row in given.tolist()]
    return [[str(value) for value in row] for row in given.tolist()]
