"""How the files of an export in C are laid out: for CMake, or as an Arduino library."""

from __future__ import annotations

from capsyn.exports.c.code import Code
from capsyn.exports.c.header import header
from capsyn.exports.c.readings.counts import limit_of
from capsyn.exports.c.source import source
from capsyn.exports.plan import Files
from capsyn.version import __version__

PACKAGES = ("cmake", "arduino")


def packaged(code: Code, package: str) -> Files:
    """Return all files of an export; those of an Arduino library are in a folder of its name."""
    p = code.prefix
    if package == "cmake":
        places, more = f"{p}", {"example/main.c": _program(code), "CMakeLists.txt": _cmake(code)}
    else:
        places = f"{p}/src/{p}"
        more = {
            f"{p}/library.properties": _properties(code),
            f"{p}/keywords.txt": _keywords(code),
            f"{p}/examples/{p}/{p}.ino": _sketch(code),
        }
    texts = {f"{places}.h": header(code), f"{places}.c": source(code), **more}
    return {name: text.encode() for name, text in texts.items()}


def _cmake(code: Code) -> str:
    """Return the text of ``CMakeLists.txt``, whose target others take as ``NAME::NAME``."""
    p, about = code.prefix, "\n".join(f"# {line}" for line in code.plan.header)
    library = ""
    if code.library:
        library = f"if(UNIX)\n    target_link_libraries({p} PUBLIC m)\nendif()\n"
    return f"""{about}
cmake_minimum_required(VERSION 3.10)
project({p} VERSION {__version__} LANGUAGES C)
include(CMakePackageConfigHelpers)
include(GNUInstallDirs)
add_library({p} STATIC {p}.c)
add_library({p}::{p} ALIAS {p})
set_target_properties({p} PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON)
target_include_directories({p} PUBLIC
    $<BUILD_INTERFACE:${{CMAKE_CURRENT_SOURCE_DIR}}>
    $<INSTALL_INTERFACE:${{CMAKE_INSTALL_INCLUDEDIR}}>)
# what a program does not use is left out by -Wl,--gc-sections
target_compile_options({p} PRIVATE -ffunction-sections -fdata-sections)
{library}# find_package({p} CONFIG) of other projects finds what is installed
install(TARGETS {p} EXPORT {p}
    ARCHIVE DESTINATION ${{CMAKE_INSTALL_LIBDIR}}
    INCLUDES DESTINATION ${{CMAKE_INSTALL_INCLUDEDIR}})
install(FILES {p}.h DESTINATION ${{CMAKE_INSTALL_INCLUDEDIR}})
install(EXPORT {p} FILE {p}Config.cmake NAMESPACE {p}::
    DESTINATION ${{CMAKE_INSTALL_LIBDIR}}/cmake/{p})
write_basic_package_version_file(${{CMAKE_CURRENT_BINARY_DIR}}/{p}ConfigVersion.cmake
    COMPATIBILITY AnyNewerVersion)
install(FILES ${{CMAKE_CURRENT_BINARY_DIR}}/{p}ConfigVersion.cmake
    DESTINATION ${{CMAKE_INSTALL_LIBDIR}}/cmake/{p})
"""


def _middle(code: Code) -> str:
    """Return readings in the middle of the domain, as entries of an array."""
    plan, domain = code.plan, code.plan.policy.space
    middle = ((domain.lower + domain.widths / 2) - plan.offset) / plan.scale
    if not code.axes:
        return ", ".join(map(code.literal, middle))
    half = limit_of(code.readings)
    turns = [axis.turn or 2 * half for axis in code.axes]  # a count in range, turns away
    counts = (round(value) for value in middle)
    return ", ".join(str(v if -half <= v < half else v % t) for v, t in zip(counts, turns))


def _program(code: Code) -> str:
    """Return a program that decides at the middle of the domain."""
    plan, p = code.plan, code.prefix
    declare = f"    {p}_state state;\n" if code.stateful else ""
    call = f"    symbol = {p}_decide(x, &status);\n"
    if code.stateful:
        now = "0u, " * code.waits
        call = f"    {p}_init(&state);\n    symbol = {p}_step(&state, x, {now}&status);\n"
    order = "" if plan.policy.exogenous is None else " /* states, then exogenous inputs */"
    value = ("(double)" if code.real == "float" else "") + f"{p}_control(symbol, i)"
    return f"""{code.about("example")}
#include <stdio.h>

#include "{p}.h"

int main(void)
{{
    const {code.reading} x[{plan.n}] = {{{_middle(code)}}};{order}
    {p}_status status;
    int16_t symbol;
    uint16_t i;
{declare}{call}    (void)printf("symbol %d, status %d\\n", (int)symbol, (int)status);
    for (i = 0u; i < {p.upper()}_INPUTS; ++i) {{
        (void)printf("control %g\\n", {value});
    }}
    return 0;
}}
"""


def _properties(code: Code) -> str:
    """Return the text of ``library.properties``, with every field that must be.

    Who publishes the library puts in author, maintainer and url.
    """
    p, policy = code.prefix, code.plan.policy
    states = ", ".join(policy.space.names)
    lines = {
        "name": p,
        "version": __version__,
        "author": "capsyn",
        "maintainer": "capsyn",
        "sentence": f"The control alphabet policy {policy.name}.",
        "paragraph": f"{code.plan.labels} symbols, decided from {states}.",
        "category": "Device Control",
        "url": "https://example.com/",
        "architectures": "*",
        "includes": f"{p}.h",
    }
    return "".join(f"{name}={' '.join(text.split())}\n" for name, text in lines.items())


def _keywords(code: Code) -> str:
    """Return the text of ``keywords.txt``, by which the editor colours names."""
    p, upper = code.prefix, code.prefix.upper()
    types, functions = ["status"], ["control", code.asked]
    if code.arithmetic == "lattice":
        functions += ["symbol", "quantise"]
    if code.stateful:
        held = ["hold", "take"] * code.waits
        types, functions = [*types, "state"], [*functions, "init", *held, "step"]
    kinds = {"KEYWORD1": [f"{p}_{name}" for name in types]}
    kinds["KEYWORD2"] = [f"{p}_{name}" for name in functions]
    kinds["LITERAL1"] = [f"{upper}_{name}" for name in ("OK", "OUTSIDE", "NOT_FINITE")]
    kinds["LITERAL1"] += [f"{upper}_NONE"] * (code.memory is not None)
    kinds["LITERAL1"] += [f"{upper}_SYMBOL_{name}" for name in code.symbols]
    return "".join(f"{word}\t{kind}\n" for kind, words in kinds.items() for word in words)


def _sketch(code: Code) -> str:
    """Return a sketch that prints the controls in the middle of the domain."""
    p, n = code.prefix, code.plan.n
    kept = "" if code.waits or not code.stateful else "    state.symbol = symbol;\n"
    init, asked, lattice = "", f"{p}_{code.asked}(x, &status)", f"{p}_symbol(z)"
    globals_ = ""
    if code.stateful:
        clock = {1e-6: "micros()", 1e-3: "millis()"}.get(code.tick, "ticks")
        globals_ = f"\nstatic {p}_state state;\n"
        if code.memory is not None:
            lattice = f"{p}_symbol(state.symbol, z)"
        if clock == "ticks" and code.waits:
            globals_ += (
                f"static uint32_t ticks = 0; /* yours: advance it every {code.tick!r} s */\n"
            )
        init = f"    {p}_init(&state);\n"
        now = f"{clock}, " * code.waits
        asked = f"{p}_step(&state, x, {now}&status)"
        if code.waits:
            lattice = f"{p}_hold(&state, {lattice}, {clock})"
    said = "what sensors say"
    if code.plan.policy.exogenous is not None:
        said = "states, then exogenous inputs"
    reading = f"""\
    const {code.reading} x[{n}] = {{{_middle(code)}}}; /* yours: {said} */
    {p}_status status;
    const int16_t symbol = {asked};
"""
    if code.guards:
        steps = ", ".join(str(count // 2) for count in code.tree.counts)
        reading = f"""\
#ifdef {p.upper()}_NO_DOUBLE /* as on AVR: from lattice steps alone */
    const {code.integer} z[{n}] = {{{steps}}}; /* yours: made of what sensors say */
    const int16_t symbol = {lattice};
{kept}#else
{reading}#endif
"""
    return f"""{code.about("example")}
#include <{p}.h>
{globals_}
void setup()
{{
    Serial.begin(9600);
{init}}}

void loop()
{{
{reading}    for (uint16_t i = 0; i < {p.upper()}_INPUTS; ++i) {{
        Serial.println({p}_control(symbol, i), 6);
    }}
    delay(100);
}}
"""
