"""Compilers and machines that run the C of an export: this computer, a Cortex-M3, an AVR."""

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest

WARNINGS = (
    "-Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wcast-qual -Wundef "
    "-Wdouble-promotion -Wfloat-equal -Wunused-function -Wmissing-prototypes -Wunused-macros "
    "-Werror"
).split()

ENTRY = """
#include "{p}.h"
void decide(long count, const {real} *x, int16_t *symbols, int32_t *statuses);
void decide(long count, const {real} *x, int16_t *symbols, int32_t *statuses)
{{
    for (long i = 0; i < count; ++i) {{
        {p}_status status;
        symbols[i] = {p}_decide(x + {n} * i, &status);
        statuses[i] = (int32_t)status;
    }}
}}
"""
NEXT = """
#include "{p}.h"
void next(long count, const {real} *x, int16_t *symbols, int32_t *statuses);
void next(long count, const {real} *x, int16_t *symbols, int32_t *statuses)
{{
    for (long i = 0; i < count; ++i) {{
        {p}_status status;
        symbols[i] = {p}_next(symbols[i], x + {n} * i, &status);
        statuses[i] = (int32_t)status;
    }}
}}
"""
"""Symbols are at first those in force."""
CONTROL = """
void controls(long count, const int16_t *symbols, const uint16_t *inputs, double *values);
void controls(long count, const int16_t *symbols, const uint16_t *inputs, double *values)
{{
    for (long i = 0; i < count; ++i) {{
        values[i] = (double){p}_control(symbols[i], inputs[i]);
    }}
}}
"""
LOOKUP = """
void look(long count, const {z} *z, int16_t *symbols);
void look(long count, const {z} *z, int16_t *symbols)
{{
    for (long i = 0; i < count; ++i) {{ symbols[i] = {p}_symbol({before}z + {n} * i); }}
}}
void quantise(long count, const {real} *x, {z} *z);
void quantise(long count, const {real} *x, {z} *z)
{{
    for (long i = 0; i < count; ++i) {{ (void){p}_quantise(x + {n} * i, z + {n} * i); }}
}}
"""
STEPS = """
void run(long count, const {real} *x, const uint32_t *now, int16_t *symbols);
void run(long count, const {real} *x, const uint32_t *now, int16_t *symbols)
{{
    {p}_state state;
    (void)now;
    {p}_init(&state);
    for (long i = 0; i < count; ++i) {{
        {p}_status status;
        symbols[i] = {p}_step(&state, x + {n} * i, {now}&status);
    }}
}}
"""
CORTEX_M = """
#include <stdint.h>
#include "{p}.h"
extern uint32_t stack_top;
int main(void);
void reset(void);
static int semihost(int operation, const void *argument)
{{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}}
void reset(void)
{{
    const uint32_t block[2] = {{0x20026u, (uint32_t)main()}};
    (void)semihost(0x20, block);
    for (;;) {{}}
}}
__attribute__((section(".vectors"), used)) const void *const vectors[] = {{
    &stack_top, (void *)reset
}};
{data}
int main(void)
{{
    int wrong = wrong_controls();
    for (int i = 0; i < {count}; ++i) {{
        wrong += wrong_at(given + {n} * i, labels[i], statuses[i]);
    }}
    return wrong > 99 ? 99 : wrong;
}}
"""
CALLS = {
    "symbol": "(void)expected; return {p}_symbol(x) != label;",
    "next": "{p}_status status; static uint16_t at = 0u;"
    " const int16_t symbol = {p}_next((int16_t)(at++ * 7ul / 5u % {symbols}), x, &status);"
    " return (symbol != label) || ((int)status != expected);",
    "decide": "{p}_status status; const int16_t symbol = {p}_decide(x, &status);"
    " return (symbol != label) || ((int)status != expected);",
    "step": "static {p}_state state; static uint32_t now = 4294967246u; {p}_status status;"
    " if (now == 4294967246u) {{ {p}_init(&state); }}"
    " const int16_t symbol = {p}_step(&state, x, now++, &status);"
    " return (symbol != label) || ((int)status != expected);",
}
"""What is called with each vector: ticks of steps wrap around to 0 on the way."""
DATA = """
static const {kind} given[] {rom} = {{{given}}};
static const uint8_t labels[] {rom} = {{{labels}}};
static const uint8_t statuses[] {rom} = {{{statuses}}};
static int wrong_at(const {kind} *x, int label, int expected) {{ {call} }}
static int wrong_controls(void)
{{
    static const {control} controls[][{m}] = {{ {controls} }};
    int wrong = 0;
    for (int16_t k = -1; k <= {symbols}; ++k) {{
        for (uint16_t i = 0; i <= {m}; ++i) {{
            const int16_t row = (k < 0) || (k == {symbols}) ? {safe} : k;
            wrong += {p}_control(k, i) != ((i == {m}) ? 0 : controls[row][i]);
        }}
    }}
    return wrong;
}}
"""
LINK = """
MEMORY {{ flash (rx) : ORIGIN = 0, LENGTH = 256K  ram (rw) : ORIGIN = 0x20000000, LENGTH = 16K }}
SECTIONS {{
  .text : {{ KEEP(*(.vectors)) *(.text*) *(.rodata*) }} > flash
  .data : {{ *(.data*) }} > ram
  .bss : {{ *(.bss*) *(COMMON) }} > ram
  stack_top = ORIGIN(ram) + LENGTH(ram);
}}
"""
AVR = """
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>
#include "{p}.h"
{data}
static void put(char c) {{ while (!(UCSR0A & (1 << UDRE0))) {{}} UDR0 = (uint8_t)c; }}
int main(void)
{{
    uint16_t wrong = wrong_controls();
    UCSR0B = 1 << TXEN0;
    for (uint16_t i = 0; i < {count}; ++i) {{
        {kind} x[{n}];
        memcpy_P(x, given + {n} * i, sizeof x);
        wrong += wrong_at(x, pgm_read_byte(labels + i), pgm_read_byte(statuses + i));
    }}
    put('w'); put('r'); put('o'); put('n'); put('g');
    for (int8_t digit = 15; digit >= 0; --digit) {{ put((char)('0' + ((wrong >> digit) & 1))); }}
    put('\\n');
    cli();
    sleep_mode();
    for (;;) {{}}
}}
"""


def need(*tools):
    for tool in tools:
        if not shutil.which(tool):
            pytest.skip(f"{tool} is not installed")


def prefix_of(files):
    (name,) = [name for name in files if name.endswith(".h")]
    return name[:-2]


def write(files, directory, **more):
    directory.mkdir(parents=True, exist_ok=True)
    for name, content in {**files, **more}.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_bytes(content if isinstance(content, bytes) else content.encode())


def call(command, directory, **options):
    done = subprocess.run(
        command, cwd=directory, capture_output=True, text=True, timeout=60, **options
    )
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


class Library:
    """The C of an export on this computer."""

    def __init__(self, files, directory, n, compiler="gcc", options=("-O1",), wide=False):
        need(compiler)
        self.prefix = p = prefix_of(files)
        header = files[f"{p}.h"].decode()
        (real,) = re.findall(rf"typedef (\w+) {p}_reading;", header)
        self.real = np.dtype(real.removesuffix("_t").replace("float", "float32")).type
        self.integer = np.int32 if "const int32_t z[" in header else np.int16
        names = {"p": p, "n": n, "real": real}
        names["z"] = self.integer.__name__ + "_t"
        self.plan, self.control = files.plan, np.dtype(_control_type(files)).type
        remembers = f"{p}_next(" in header
        names["before"] = "symbols[i], " * remembers
        names["now"] = "now[i], " * ("uint32_t now" in header)
        text = NEXT if remembers else ENTRY
        text += CONTROL
        text += LOOKUP * (f"{p}_symbol(" in header) + STEPS * (f"{p}_step(" in header)
        whole = files[f"{p}.c"].decode() + text.format(**names)  # one file is compiled faster
        write(files, directory, **{"whole.c": whole})
        flags = ["-std=c99", *options, *WARNINGS, "-shared", "-fPIC"]
        call([compiler, *flags, "whole.c", "-o", "library.so"], directory)
        self.quantises = f"{p}_symbol(" in header
        self.library = ctypes.CDLL(str(directory / "library.so"))
        self._check_controls()

    def _check_controls(self):
        """Assert that the controls of symbols, and of what is none, are those of the policy."""
        plan, m = self.plan, self.plan.policy.alphabet.m
        symbols = np.array([*range(plan.labels), -1, plan.labels % (1 << 15), -(1 << 15)])
        inputs = np.array([*range(m), m, (1 << 16) - 1])
        asked = [np.repeat(symbols, len(inputs)), np.tile(inputs, len(symbols))]
        values = np.full(len(asked[0]), np.nan)
        self._call("controls", asked[0].astype(np.int16), asked[1].astype(np.uint16), values)
        rows = np.where((symbols >= 0) & (symbols < plan.labels), symbols, plan.safe)
        expected = np.zeros((len(symbols), len(inputs)))
        expected[:, :m] = plan.policy.controls.astype(self.control)[rows]
        assert np.array_equal(values, expected.ravel())

    def _call(self, name, *arrays):
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        getattr(self.library, name)(ctypes.c_long(len(arrays[0])), *pointers)

    def decide(self, states):
        x = np.ascontiguousarray(states, dtype=self.real)
        symbols, statuses = np.empty(len(x), np.int16), np.empty(len(x), np.int32)
        self._call("decide", x, symbols, statuses)
        return symbols, statuses

    def next(self, in_force, states):
        x = np.ascontiguousarray(states, dtype=self.real)
        symbols, statuses = np.array(in_force, np.int16), np.empty(len(x), np.int32)
        self._call("next", x, symbols, statuses)
        return symbols, statuses

    def look(self, steps, in_force=None):
        symbols = np.array(np.zeros(len(steps)) if in_force is None else in_force, np.int16)
        self._call("look", np.ascontiguousarray(steps, dtype=self.integer), symbols)
        return symbols

    def steps(self, states):
        x = np.ascontiguousarray(states, dtype=self.real)
        steps = np.empty(x.shape, self.integer)
        self._call("quantise", x, steps)
        return steps

    def run(self, states, now):
        x, symbols = np.ascontiguousarray(states, dtype=self.real), np.empty(len(states), np.int16)
        self._call("run", x, np.ascontiguousarray(now, dtype=np.uint32), symbols)
        return symbols


def _control_type(files):
    p = prefix_of(files)
    (real,) = re.findall(rf"^(\w+) {p}_control\(", files[f"{p}.h"].decode(), re.M)
    return real


def _literal(value, suffix=""):
    if isinstance(value, int):
        return str(value)
    if not np.isfinite(value):
        return '__builtin_nan("")' if np.isnan(value) else f"{'-' * (value < 0)}__builtin_inf()"
    return repr(value) + suffix


def _vectors(files, golden, asked, rom, count):
    """Return what the programs of a processor are made of."""
    p = prefix_of(files)
    kind, given = "int16_t", golden.steps
    if asked != "symbol":
        (kind,) = re.findall(rf"typedef (\w+) {p}_reading;", files[f"{p}.h"].decode())
        given = golden.readings
    suffix = "f" if kind == "float" else ""
    text = {
        "given": ", ".join(_literal(v, suffix) for v in given[:count].ravel().tolist()),
        "labels": ", ".join(map(str, golden.labels[:count].tolist())),
        "statuses": ", ".join(map(str, golden.statuses[:count].tolist())),
    }
    plan, real = files.plan, _control_type(files)
    values = [
        [_literal(v, "f" * (real == "float")) for v in u] for u in plan.policy.controls.tolist()
    ]
    controls = ", ".join("{" + ", ".join(row) + "}" for row in values)
    text |= {"control": real, "controls": controls, "m": plan.policy.alphabet.m}
    text |= {"symbols": plan.labels, "safe": plan.safe, "p": p}
    data = DATA.format(
        **text, kind=kind, rom=rom, call=CALLS[asked].format(p=p, symbols=plan.labels)
    )
    return {"data": data, "kind": kind, "p": p, "n": given.shape[1], "count": len(given[:count])}


def cortex_m3(files, golden, directory, asked="symbol"):
    """Return how many golden vectors a Cortex-M3 gets wrong, at most 99."""
    need("arm-none-eabi-gcc", "qemu-system-arm")
    p = prefix_of(files)
    main = CORTEX_M.format(**_vectors(files, golden, asked, "", len(golden)))
    write(files, directory, **{"main.c": main, "link.ld": LINK.format()})
    command = "arm-none-eabi-gcc -std=gnu99 -mcpu=cortex-m3 -mthumb -Os -ffreestanding -nostdlib"
    more = ["-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections", "-T", "link.ld"]
    more += ["main.c", f"{p}.c", "-lgcc", "-o", "main.elf"]
    call([*command.split(), *more], directory)
    machine = (
        "qemu-system-arm -M lm3s6965evb -nographic -monitor none -serial none -kernel main.elf"
    )
    target = ["-semihosting-config", "enable=on,target=native"]
    return subprocess.run([*machine.split(), *target], cwd=directory, timeout=60).returncode


def avr(files, golden, directory, asked="symbol"):
    """Return how many of 1,000 golden vectors an ATmega328P gets wrong: as many as it holds."""
    need("avr-gcc", "simavr")
    p = prefix_of(files)
    write(
        files,
        directory,
        **{"main.c": AVR.format(**_vectors(files, golden, asked, "PROGMEM", 1000))},
    )
    command = "avr-gcc -std=gnu99 -mmcu=atmega328p -Os -ffunction-sections -fdata-sections"
    more = [
        "-Wall",
        "-Wextra",
        "-Werror",
        "-Wl,--gc-sections",
        "main.c",
        f"{p}.c",
        "-o",
        "main.elf",
    ]
    call([*command.split(), *more], directory)
    told = call(["simavr", "-m", "atmega328p", "-f", "16000000", "main.elf"], directory)
    (digits,) = re.findall(r"wrong([01]{16})", told)
    return int(digits, 2)
