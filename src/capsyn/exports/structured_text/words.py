"""Words that no name in Structured Text may be: of the language, of its library, of tools."""

from __future__ import annotations

TYPES = """
    bool byte word dword lword sint int dint lint usint uint udint ulint real lreal time date tod dt
    string wstring
""".split()
"""Elementary types."""
LANGUAGE = """
    abstract action and any any_bit any_date any_derived any_elementary any_int any_magnitude
    any_num any_real any_string array at begin bit by case char class configuration const constant
    continue date_and_time do else elsif en end_action end_case end_class end_configuration end_for
    end_function end_function_block end_if end_interface end_method end_namespace end_program
    end_property end_region end_repeat end_resource end_step end_struct end_transition end_type
    end_var end_while eno exit extends f_edge false final for from function function_block get goto
    if implements ini initial_step interface internal interval label ldate ldt ltime ltod method mod
    namespace non_retain not null of on or override persistent pointer priority private program
    property protected public pvoid r_edge read_only read_write dref ref ref_to reference region
    repeat resource retain return set single step struct super task then this time_of_day to
    transition true type union until using uxint var var_access var_config var_external var_global
    var_in_out var_input var_inst var_output var_stat var_temp void wchar while with xint xor xword
""".split()
"""Words of editions 2 and 3 and of Siemens SCL."""
LISTS = """
    add andn cal calc calcn caln cd cdt clk cu cv div eq et ge gt in jmp jmpc jmpcn ld ldn le lt mul
    ne orn pt pv q q1 qd qu r r1 ret retc retcn s s1 st stn sub t xorn
""".split()
"""Operators of Instruction List, and parameters of standard function blocks."""
LIBRARY = """
    abs acos add_dt_time add_time add_tod_time adr asin atan atan2 bcd_to_int bitadr concat
    concat_date_tod cos ctd ctu ctud day_of_week delete derivative divtime exp expt f_trig find
    hysteresis indexof insert integral ispoint ldexp left len limit ln log lower_bound max mid min
    move multime mux neg overlap pid r_trig ramp replace right rol ror round rs rtc sel sema shl shr
    sin sizeof sqrt sr sub_date_date sub_dt_dt sub_dt_time sub_time sub_tod_time sub_tod_tod tan tof
    ton tp trunc upper_bound
""".split()
"""Functions and function blocks that compilers bring along."""
CONVERSIONS = [f"{a}_to_{b}" for a in TYPES for b in TYPES if a != b]
"""Functions from each type to each other."""
KEYWORDS = frozenset(TYPES + LANGUAGE + LISTS + LIBRARY + CONVERSIONS)
"""All of them, in small letters: capital and small letters are the same."""
