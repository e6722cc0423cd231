"""Words that no name in Structured Text may be: of the language, of its library, of tools."""

from __future__ import annotations

TYPES = """
    bool byte word dword lword sint int dint lint usint uint udint ulint real lreal time date tod dt
    string wstring
""".split()
"""Elementary types."""
LANGUAGE = """
    abstract action and any any_bit any_date any_derived any_elementary any_int any_magnitude
    any_num any_real any_string array at begin by case class configuration const constant continue
    date_and_time do else elsif en end_action end_case end_class end_configuration end_for
    end_function end_function_block end_if end_interface end_method end_namespace end_program
    end_property end_region end_repeat end_resource end_step end_struct end_transition end_type
    end_var end_while eno exit extends f_edge false final for from function function_block goto if
    implements initial_step interface internal interval label method mod namespace non_retain not
    null of on or override persistent pointer priority private program property protected public
    r_edge read_only read_write ref ref_to reference region repeat resource retain return single
    step string# struct super task then this time_of_day to transition true type until using var
    var_access var_config var_external var_global var_in_out var_input var_output var_temp void
    while with xor char wchar ldate ltime ltod ldt
""".split()
"""Words of editions 2 and 3 and of Siemens SCL."""
LISTS = """
    add andn cal calc calcn cd clk cu cv div eq et ge gt in jmp jmpc jmpcn ld ldn le lt mul ne orn
    pt pv q q1 qd qu r r1 ret retc retcn s s1 st stn sub xorn
""".split()
"""Operators of Instruction List, and parameters of standard function blocks."""
LIBRARY = """
    abs acos adr asin atan atan2 bcd_to_int bitadr concat concat_date_tod cos ctd ctu ctud delete
    derivative exp expt f_trig find hysteresis indexof insert integral ispoint ldexp left len limit
    ln log lower_bound max mid min move mux neg overlap pid r_trig ramp replace right rol ror round
    rs rtc sel sema shl shr sin sizeof sqrt sr tan tof ton tp trunc upper_bound
    add_time add_tod_time add_dt_time multime divtime sub_time sub_date_date sub_tod_time
    sub_tod_tod sub_dt_time sub_dt_dt day_of_week
""".split()
"""Functions and function blocks that compilers bring along."""
CONVERSIONS = [f"{a}_to_{b}" for a in TYPES for b in TYPES if a != b]
KEYWORDS = frozenset(TYPES + LANGUAGE + LISTS + LIBRARY + CONVERSIONS)
"""All of them, in small letters: capital and small letters are the same."""
