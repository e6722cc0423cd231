"""What Windows lacks, hidden from capsyn: on PYTHONPATH, it holds for a process and its children.

Modules of capsyn cannot import modules of POSIX, see no names of POSIX in ``os`` and ``signal``,
and find nothing in /proc. Other packages have branches of their own for Windows, and see all.
"""

import builtins
import os
import signal
import sys
import types

MODULES = {"fcntl", "resource", "pwd", "grp", "pty", "tty", "termios", "syslog", "posix"}
NAMES = {
    os: {
        *"getuid geteuid getgid getegid getpgid setsid fork forkpty killpg mkfifo mknod".split(),
        *"chown fchown fchmod lchown sched_getaffinity sysconf uname nice statvfs".split(),
        *"pread pwrite O_CLOEXEC O_NONBLOCK O_NOFOLLOW O_DIRECTORY WNOHANG wait".split(),
    },
    signal: {"SIGKILL", "SIGHUP", "SIGALRM", "SIGQUIT", "SIGUSR1", "alarm", "setitimer", "pause"},
}
import_ = builtins.__import__


def without(module, names):
    """Return a module as it is seen by those from whom some of its names are hidden."""

    class Shown(types.ModuleType):
        def __getattribute__(self, name):
            if name in names:
                raise AttributeError(f"module '{module.__name__}' has no attribute '{name}'")
            return getattr(module, name)

        def __setattr__(self, name, value):
            setattr(module, name, value)

        def __delattr__(self, name):
            delattr(module, name)

    return Shown(module.__name__)


SHOWN = {module.__name__: without(module, names) for module, names in NAMES.items()}


def import_of_windows(name, globals=None, locals=None, fromlist=(), level=0):
    """Import for capsyn what Windows has, for others what there is."""
    if level == 0 and (globals or {}).get("__name__", "").partition(".")[0] == "capsyn":
        if name.partition(".")[0] in MODULES:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
        if name in SHOWN:
            return SHOWN[name]
    return import_(name, globals, locals, fromlist, level)


def refuse_proc(event, arguments):
    """Let capsyn open nothing in /proc; what it calls may."""
    if event == "open" and str(arguments[0]).startswith("/proc"):
        frame = sys._getframe(1)
        while frame and frame.f_globals.get("__name__", "").partition(".")[0] in ("pathlib", "io"):
            frame = frame.f_back
        if frame and frame.f_globals.get("__name__", "").startswith("capsyn"):
            raise FileNotFoundError(2, "No such file or directory", arguments[0])


builtins.__import__ = import_of_windows
sys.addaudithook(refuse_proc)
