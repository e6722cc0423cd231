"""What the C code of an export takes on a processor, measured with its compiler."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from capsyn.exports.plan import Files

COMPILERS = {
    "cortex-m0": ["arm-none-eabi-gcc", "-mcpu=cortex-m0", "-mthumb"],
    "cortex-m4": ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb"],
    "avr": ["avr-gcc", "-mmcu=atmega328p"],
    "host": ["gcc"],
}
"""Processors and their compilers."""
SECONDS = 20
"""Longest that a compiler may take; a processor whose compiler takes longer is left out."""
FLASH = (".text", ".rodata", ".progmem")
RAM = (".data", ".bss")


def sizes(
    files: Files, prefix: str, processors: Iterable[str] = tuple(COMPILERS)
) -> dict[str, dict[str, int | str]]:
    """Return what the code takes at ``-Os``, by processor; `prefix` names header and source.

    Of each ``compiler``: its name and version; ``decision``: code and tables from lattice steps, or
    from states, to a symbol; ``quantiser``: how much more it takes from states, without the
    compiler's arithmetic; ``with_library``: what both take with it, and with the mathematical
    functions that features call, where it links [bytes]; ``ram``: static memory [bytes]; ``stack``
    and ``stack_from_states``: of the deepest chains of calls, without those of libraries [bytes].
    Without ``quantiser`` where a processor has no double precision. Processors are left out whose
    compiler is missing, fails or has not its linker.
    """
    of_compiler = functools.partial(_of_compiler, files=files, prefix=prefix)
    chosen = {name: COMPILERS[name] for name in processors}
    with ThreadPoolExecutor(len(chosen)) as pool:
        by_compiler = pool.map(of_compiler, chosen.values())
        return {name: measured for name, measured in zip(chosen, by_compiler) if measured}


def _of_compiler(command: list[str], files: Files, prefix: str) -> dict[str, int | str]:
    """Return the sizes for one compiler; none where it is missing or the code is not for it."""
    if not shutil.which(command[0]):
        return {}
    with tempfile.TemporaryDirectory() as directory:
        for name in (f"{prefix}.h", f"{prefix}.c"):
            Path(directory, name).write_bytes(files[name])
        measured = _measure(command, Path(directory), prefix)
    return {"compiler": version_of(command[0]), **measured} if measured else {}


def version_of(compiler: str) -> str:
    """Return the name and the version of a compiler."""
    version = run_tool([compiler, "-dumpfullversion", "-dumpversion"], Path())
    return f"{compiler} {(version or '').strip()}".strip()


def run_tool(command: list[str], directory: Path, errors: int = subprocess.DEVNULL) -> str | None:
    """Return what a command says; none where it fails, is missing or does not end."""
    try:
        process = subprocess.Popen(
            command, cwd=directory, stdout=subprocess.PIPE, stderr=errors,
            encoding="utf-8", errors="replace", start_new_session=True,
        )  # fmt: skip
    except OSError:
        return None
    with process:
        try:
            output, _ = process.communicate(timeout=SECONDS)
        except BaseException as error:
            _end(process.pid)
            if isinstance(error, subprocess.TimeoutExpired):
                return None
            raise
    return output if process.returncode == 0 else None


def _end(number: int) -> None:
    """End a process and all that it started, such as a driver and its compiler.

    It leads a group of processes where the system has these: what it started is found there though
    it has died itself.
    """
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError):  # all have ended
            os.killpg(number, signal.SIGKILL)
        return
    import psutil  # heavy for what is rarely needed

    with contextlib.suppress(psutil.NoSuchProcess):
        driver = psutil.Process(number)
        for process in (*driver.children(recursive=True), driver):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()


def _measure(command: list[str], directory: Path, prefix: str) -> dict[str, int]:
    """Return the sizes for one compiler; none where the code is not for it."""
    tool = command[0].removesuffix("gcc")
    compile_ = [*command, "-std=c99", "-Os", "-ffreestanding", "-fno-pic"]
    compile_.append("-fno-asynchronous-unwind-tables")
    apart = ["-ffunction-sections", "-fdata-sections", "-fstack-usage"]
    if run_tool([*compile_, *apart, "-c", f"{prefix}.c", "-o", "code.o"], directory) is None:
        return {}
    source = (directory / f"{prefix}.c").read_text(encoding="utf-8")
    defined = (run_tool([f"{tool}nm", "code.o"], directory) or "").split()
    public = f"{prefix}_symbol" in defined
    roots = [f"{prefix}_symbol"] if public else []
    roots += [name for name in (f"{prefix}_decide", f"{prefix}_next") if name in defined]
    stack = (directory / "code.su").read_text(encoding="utf-8")
    usage = [line.split("\t") for line in stack.splitlines()]
    frames = {row[0].split(":")[-1]: int(row[1]) for row in usage}  # of functions that are left
    calls = _calls(source, prefix)
    library = ["-lm", "-lc", "-lgcc"] if "#include <math.h>" in source else ["-lgcc"]
    by_root = {root: _linked(command, directory, tool, root, library) for root in roots}
    if not roots or not all(flash for flash, _, _ in by_root.values()):
        return {}
    measured = dict(zip(("decision", "ram"), by_root[roots[0]][:2]))
    if len(roots) == 2:
        measured["quantiser"] = by_root[roots[1]][0] - measured["decision"]
    whole = by_root[roots[-1]][2]
    if whole:
        measured["with_library"] = whole
    measured["stack"] = _deepest(roots[0], calls, frames)
    measured["stack_from_states"] = _deepest(roots[-1], calls, frames)
    return measured


def _linked(
    command: list[str], directory: Path, tool: str, root: str, library: list[str]
) -> tuple[int, int, int | None]:
    """Return flash and static RAM of what a function needs of our own, and flash with libraries."""
    own = [*command, "-nostdlib", "-nostartfiles", "-r", "-Wl,--gc-sections", f"-Wl,-e,{root}"]
    own += [f"-Wl,-u,{root}", "code.o", "-o", "own.o"]
    whole = [*command, "-nostdlib", "-nostartfiles", "-Wl,--gc-sections", f"-Wl,-e,{root}"]
    whole += ["code.o", *library, "-o", "whole.elf"]
    sections = []
    for link, name in ((own, "own.o"), (whole, "whole.elf")):
        text = None
        if run_tool(link, directory) is not None:
            text = run_tool([f"{tool}size", "-A", name], directory)
        sections.append(_sections(text) if text else None)
    flash, ram = sections[0] or (0, 0)
    return flash, ram, sections[1][0] if sections[1] else None


def _sections(text: str) -> tuple[int, int]:
    """Return bytes of flash and of static RAM in what ``size -A`` says."""
    flash = ram = 0
    for line in text.splitlines():
        words = line.split()
        if len(words) == 3 and words[1].isdigit():
            flash += int(words[1]) * words[0].startswith(FLASH)
            ram += int(words[1]) * words[0].startswith(RAM)
    return flash, ram


def _calls(source: str, prefix: str) -> dict[str, set[str]]:
    """Return which functions of the source each one names."""
    function = rf"^\S[^\n]*?\b({prefix}_\w+)\([^;]*?\)\n\{{\n(.*?)^\}}"
    bodies = re.finditer(function, source, re.M | re.S)
    return {body[1]: set(re.findall(rf"\b({prefix}_\w+)\(", body[2])) for body in bodies}


def _deepest(name: str, calls: dict[str, set[str]], frames: dict[str, int]) -> int:
    """Return the stack of the deepest chain of calls; functions without a frame are inlined."""
    below = [_deepest(callee, calls, frames) for callee in calls.get(name, ()) if callee != name]
    return frames.get(name, 0) + max(below, default=0)
