"""Words and lines of Structured Text."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable

from capsyn.exports.text import WIDTH

KEYWORDS = frozenset(
    """
    abs abstract acos action add and andn any any_bit any_date any_int any_num any_real array asin
    at atan atan2 bcd_to_int begin bool by byte cal calc calcn caln case cd cdt char class clk
    concat configuration constant continue cos ctd ctu ctud cu cv date date_and_time delete dint
    div do dt dword else elsif en end_action end_case end_class end_configuration end_for
    end_function end_function_block end_if end_interface end_method end_namespace end_program
    end_property end_repeat end_resource end_step end_struct end_transition end_type end_var
    end_while eno eq et exit exp expt extends f_edge f_trig false final find for from function
    function_block ge get goto gt if implements in initial_step insert int interface internal
    interval ispoint jmp jmpc jmpcn ld ldate ldn ldt le left len limit lint ln log lower_bound lreal
    lt ltime ltod lword max method mid min mod move mul mux namespace ne neg non_retain not null of
    on or orn overlap override persistent pointer priority private program property protected pt
    public pv q q1 qd qu r r1 r_edge r_trig read_only read_write real ref ref_to reference repeat
    replace resource ret retain retc retcn return right rol ror rs s s1 sel set shl shr sin single
    sint sizeof sqrt sr st step stn string string# struct sub super t tan task then this time
    time_of_day to tod tof ton tp transition true trunc type udint uint ulint until upper_bound
    using usint var var_access var_config var_external var_global var_in_out var_input var_output
    var_temp wchar while with word wstring xor xorn adr bitadr dint_to_lreal dint_to_int
    int_to_dint
    """.split()
)
"""Words that the language or its well-known tools keep for themselves."""


def real(value: float) -> str:
    """Return an LREAL literal: 17 digits where needed, always with a point."""
    digits, _, power = repr(float(value)).partition("e")
    digits += "" if "." in digits else ".0"
    return f"{digits}E{int(power)}" if power else digits


def plain(text: str) -> str:
    """Return text for a comment: ASCII, of one line, without marks of comments."""
    text = re.sub(r"[\x00-\x1f\x7f]+", " ", text).replace("(*", "( *").replace("*)", "* )")
    return text.encode("ascii", "backslashreplace").decode()


def comment(lines: Iterable[str], indent: int = 0) -> Iterable[str]:
    """Return lines as comments, broken where they are too long."""
    for line in lines:
        for part in textwrap.wrap(plain(line), WIDTH - 6 - indent, subsequent_indent="  ") or [""]:
            yield f"{indent * ' '}(* {part} *)"


def declared(declaration: str, about: str) -> list[str]:
    """Return a declaration with a comment behind it, or before it where that is too long."""
    text = plain(about).rstrip("*( ")
    if len(declaration) + len(text) + 11 <= WIDTH:
        return [f"    {declaration} (* {text} *)"]
    return [*comment([text], indent=4), f"    {declaration}"]


def condition(before: str, parts: Iterable[str], after: str, by: str = "AND") -> list[str]:
    """Return a condition of several parts, one a line, that are joined by AND or OR."""
    indent = " " * (len(before) - len(before.lstrip()) + 4)
    rows = [f"{indent}{f'{by} ' * (k > 0)}{part}" for k, part in enumerate(parts)]
    return [before, *rows, f"{indent[4:]}{after}"]
