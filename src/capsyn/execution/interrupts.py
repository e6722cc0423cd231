"""Ctrl-C ends the command line soon, whatever compiled code its threads are in.

Python hears of it between two of its own instructions only, and joins its threads before it ends.
So a thread listens to what the signal itself writes, and ends the process where it has not ended
within `GRACE`.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator

from capsyn.execution.files import remove_unfinished

GRACE = 0.4
"""Time that an interrupted process has to end by itself [s]."""
INTERRUPTED = 130
"""Exit status after Ctrl-C."""


class _State:
    advice = ""
    lasting = 0
    told = False


def advise(text: str) -> None:
    """Say what an interrupted command may be told next time."""
    _State.advice = text


def tell() -> None:
    """Print once that the command was interrupted."""
    if not _State.told:
        _State.told = True
        print("interrupted" + (f": {_State.advice}" if _State.advice else ""), file=sys.stderr)
        sys.stderr.flush()


@contextlib.contextmanager
def lasting() -> Iterator[None]:
    """Let the first Ctrl-C be only for the work within, which ends by itself or keeps results."""
    _State.lasting += 1
    try:
        yield
    finally:
        _State.lasting -= 1


@contextlib.contextmanager
def ending_soon() -> Iterator[None]:
    """Let Ctrl-C end the process within `GRACE` from here on, and from within after that."""
    _State.advice, _State.told = "", False
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours, theirs = socket.socketpair()
    theirs.setblocking(False)
    before = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_listen, args=(ours,), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        theirs.close()


def _listen(ours: socket.socket) -> None:
    """End the process some time after a Ctrl-C, after the second one where work is lasting."""
    heard = 0
    with ours:
        while numbers := ours.recv(64):
            heard += numbers.count(signal.SIGINT)
            if heard > 1 or (heard and not _State.lasting):
                threading.Event().wait(GRACE)
                tell()
                remove_unfinished()
                os._exit(INTERRUPTED)
