"""Words of Verilog, and lines of comments."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from capsyn.exports.text import WIDTH

KEYWORDS = frozenset(
    """
    always and assign automatic begin buf bufif0 bufif1 case casex casez cell cmos config deassign
    default defparam design disable edge else end endcase endconfig endfunction endgenerate
    endmodule endprimitive endspecify endtable endtask event for force forever fork function
    generate genvar highz0 highz1 if ifnone incdir include initial inout input instance integer
    join large liblist library localparam macromodule medium module nand negedge nmos nor
    noshowcancelled not notif0 notif1 or output parameter pmos posedge primitive pull0 pull1
    pulldown pullup pulsestyle_ondetect pulsestyle_onevent rcmos real realtime reg release repeat
    rnmos rpmos rtran rtranif0 rtranif1 scalared showcancelled signed small specify specparam
    strong0 strong1 supply0 supply1 table task time tran tranif0 tranif1 tri tri0 tri1 triand trior
    trireg unsigned use uwire vectored wait wand weak0 weak1 while wire wor xnor xor

    accept_on alias always_comb always_ff always_latch assert assume before bind bins binsof bit
    break byte chandle checker class clocking const constraint context continue cover covergroup
    coverpoint cross dist do endchecker endclass endclocking endgroup endinterface endpackage
    endprogram endproperty endsequence enum eventually expect export extends extern final
    first_match foreach forkjoin global iff ignore_bins illegal_bins implements implies import
    inside int interconnect interface intersect join_any join_none let local logic longint matches
    modport nettype new nexttime null package packed priority program property protected pure rand
    randc randcase randsequence ref reject_on restrict return s_always s_eventually s_nexttime
    s_until s_until_with sequence shortint shortreal soft solve static string strong struct super
    sync_accept_on sync_reject_on tagged this throughout timeprecision timeunit type typedef union
    unique unique0 until until_with untyped var virtual void wait_order weak wildcard with within

    abort abs access after alignas alignof all and_eq architecture array asm auto bitand bitor
    block body bool buffer bus catch char char16_t char32_t compl component concept configuration
    const_cast constexpr decltype delete double downto dynamic_cast elsif entity exit explicit
    false file float friend generic goto group guarded impure in inertial inline is label linkage
    literal long loop map mod mutable namespace next noexcept not_eq nullptr of on open operator
    or_eq others out override port postponed private procedure process public range record
    register reinterpret_cast reject rem report requires rol ror select severity shared short
    signal sizeof sla sll sra srl static_assert static_cast subtype switch template then
    thread_local throw to transport true try typeid typename unaffected units until using
    variable volatile wchar_t when xor_eq
    """.split()
)
"""Words of Verilog-2005 and SystemVerilog, and of C++ and VHDL, into which tools translate it."""


def comment(lines: Iterable[str]) -> list[str]:
    """Return lines as comments of ASCII, broken where they are too long."""
    comments = []
    for line in lines:
        plain = line.encode("ascii", "backslashreplace").decode().replace("\\", "/")
        comments += textwrap.wrap(
            plain, WIDTH, initial_indent="// ", subsequent_indent="//   "
        ) or ["//"]
    return comments


def signed(value: int, bits: int) -> str:
    """Return a signed literal; the least number has no positive counterpart."""
    if value == -(2 ** (bits - 1)):
        return f"{bits}'sh{2 ** (bits - 1):x}"
    return f"-{bits}'sd{-value}" if value < 0 else f"{bits}'sd{value}"
