"""What builds an export in C and shows its use: a CMake project and an example."""

from __future__ import annotations

from capsyn.exports.c.code import Code


def cmake(code: Code) -> str:
    """Return the text of ``CMakeLists.txt``."""
    prefix, about = code.prefix, "\n".join(f"# {line}" for line in code.plan.header)
    return f"""{about}
cmake_minimum_required(VERSION 3.10)
project({prefix} C)
add_library({prefix} STATIC {prefix}.c)
set_target_properties({prefix} PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON)
target_include_directories({prefix} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
# what a program does not use is left out by -Wl,--gc-sections
target_compile_options({prefix} PRIVATE -ffunction-sections -fdata-sections)
"""


def example(code: Code) -> str:
    """Return a program that decides at the middle of the domain."""
    plan, p, domain = code.plan, code.prefix, code.plan.policy.domain
    middle = ((domain.lower + domain.widths / 2) - plan.offset) / plan.scale
    values = ", ".join(str(round(v)) if code.axes else code.literal(v) for v in middle)
    declare = f"    {p}_state state;\n" if plan.dwell else ""
    call = f"    symbol = {p}_decide(x, &status);\n"
    if plan.dwell:
        call = f"    {p}_init(&state);\n    symbol = {p}_step(&state, x, 0u, &status);\n"
    first = ("(double)" if code.real == "float" else "") + f"{p}_controls[symbol][0]"
    return f"""{code.about("example")}
#include <stdio.h>

#include "{p}.h"

int main(void)
{{
    const {code.reading} x[{plan.n}] = {{{values}}};
    {p}_status status;
    int16_t symbol;
{declare}{call}    (void)printf("symbol %d, status %d\\n", (int)symbol, (int)status);
    (void)printf("control %g\\n", {first});
    return 0;
}}
"""
