"""Programs that call a decision with each of some inputs, and tell the one that takes longest.

A clock is read before and after a call. What is told is the time of the call, the function and its
return: an empty function, called the same way, gives what is measured besides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

_MAIN = """
#include "{prefix}.h"

{start}
typedef int16_t (*function)({arguments});
static int16_t (*volatile called)({arguments});
{status}
{empty}
static uint32_t taken(function asked, const {kind} *x, int16_t *symbol)
{{
    called = asked;
    {begin}
    *symbol = called({passed});
    {end}
}}

static const {kind} given[] {rom} = {{
{entries}
}};

int main(void)
{{
    uint32_t most = 0, besides;
    uint16_t at = 0;
    int16_t symbol = 0, found = 0;
    static {kind} x[{n}];
    {init}
    besides = taken(empty, x, &symbol);
    for (uint32_t i = 0; i < {count}u; ++i) {{
        uint32_t time;
        {load}
        time = taken({prefix}_{asked}, x, &symbol) - besides + {call}u;
        if (time > most) {{
            most = time;
            at = (uint16_t)i;
            found = symbol;
        }}
    }}
    tell(most);
    tell(at);
    tell((uint32_t)(uint16_t)found);
    {done}
}}
"""
AVR = {
    "start": """\
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>

static void tell(uint32_t value)
{
    uint8_t digit = 32;
    while (digit > 0) {
        while (!(UCSR0A & (1 << UDRE0))) {}
        UDR0 = (uint8_t)('0' + ((value >> --digit) & 1));
    }
    while (!(UCSR0A & (1 << UDRE0))) {}
    UDR0 = '\\n';
}
""",
    "empty": """\
__attribute__((naked, noinline)) static int16_t empty({arguments})
{{
    __asm__ volatile("ret");
}}
""",
    # a timer that counts cycles, and one that counts 1,024 of them at a time
    "begin": "const uint16_t coarse = TCNT3, fine = TCNT1;",
    "end": """\
const uint16_t cycles = (uint16_t)(TCNT1 - fine);
    const uint32_t about = 1024u * (uint32_t)(uint16_t)(TCNT3 - coarse);
    return about + (uint32_t)(int32_t)(int16_t)(uint16_t)(cycles - (uint16_t)about);""",
    "rom": "PROGMEM",
    "init": "UCSR0B = 1 << TXEN0;\n    TCCR3B = 5;\n    TCCR1B = 1;",
    "load": "memcpy_P(x, given + {n} * i, sizeof x);",
    "call": "8",  # call and ret
    "done": "cli();\n    sleep_mode();\n    for (;;) {}",
}
"""Of an AVR: cycles."""
CORTEX_M3 = {
    "start": """\
extern uint32_t stack_top;
int main(void);
void reset(void);
static int semihost(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}
void reset(void)
{
    (void)main();
    (void)semihost(0x18, (const void *)0x20026); /* the program has ended */
    for (;;) {}
}
__attribute__((section(".vectors"), used)) const void *const vectors[] = {
    &stack_top, (void *)reset
};
static void tell(uint32_t value)
{
    char text[34];
    int digit;
    for (digit = 0; digit < 32; ++digit) {
        text[digit] = (char)('0' + ((value >> (31 - digit)) & 1u));
    }
    text[32] = '\\n';
    text[33] = 0;
    (void)semihost(4, text);
}
""",
    "empty": """\
__attribute__((naked, noinline)) static int16_t empty({arguments})
{{
    __asm__ volatile("bx lr");
}}
""",
    # a timer of 25 MHz; an instruction takes 128 ns, or 3.2 of its ticks, so that none is lost
    "begin": "const uint32_t begin = *(volatile uint32_t *)0x40000004;",
    "end": """\
const uint32_t ticks = begin - *(volatile uint32_t *)0x40000004;
    return (uint32_t)((10u * (uint64_t)ticks + 16u) / 32u);""",
    "rom": "",
    "init": """\
*(volatile uint32_t *)0x40000008 = 0xffffffffu;
    *(volatile uint32_t *)0x40000004 = 0xffffffffu;
    *(volatile uint32_t *)0x40000000 = 1u;""",
    "load": "for (int k = 0; k < {n}; ++k) {{ x[k] = given[{n}u * i + (uint32_t)k]; }}",
    "call": "2",  # bl and bx
    "done": "return 0;",
}
"""Of a Cortex-M3 of QEMU's board mps2-an385, at ``-icount shift=7``: instructions."""
LINK = """\
MEMORY { flash (rx) : ORIGIN = 0, LENGTH = 4M  ram (rw) : ORIGIN = 0x20000000, LENGTH = 4M }
SECTIONS {
  .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) } > flash
  .data : { *(.data*) } > ram
  .bss : { *(.bss*) *(COMMON) } > ram
  stack_top = ORIGIN(ram) + LENGTH(ram);
}
"""
"""The memory of that board, for the linker."""


def program(
    parts: Mapping[str, str],
    prefix: str,
    asked: str,
    kind: str,
    rows: Sequence[Sequence[str]],
    in_force: int | None = None,
) -> str:
    """Return a program for a processor.

    Parameters
    ----------
    parts : mapping
        `AVR` or `CORTEX_M3`.
    prefix, asked : str
        The function is ``<prefix>_<asked>``; others than "symbol" take a status besides.
    kind : str
        Type of its inputs.
    rows : sequence
        Literals of the inputs of each call.
    in_force : int, optional
        The symbol in force, of functions that are asked for it.
    """
    n, decides = len(rows[0]), asked != "symbol"
    before = ("int16_t in_force, ", f"{in_force}, ") if in_force is not None else ("", "")
    words = {
        "prefix": prefix,
        "asked": asked,
        "kind": kind,
        "n": n,
        "count": len(rows),
        "entries": ",\n".join("    " + ", ".join(row) for row in rows),
        "arguments": f"{before[0]}const {kind} *x" + f", {prefix}_status *status" * decides,
        "passed": before[1] + ("x, &status" if decides else "x"),
        "status": f"static {prefix}_status status;\n" * decides,
    }
    own = {key: value.format(**words) if key in ("empty", "load") else value
           for key, value in parts.items()}  # fmt: skip
    return _MAIN.format(**words, **own)
