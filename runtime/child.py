"""Start a program that dies with its parent: `python child.py PARENT_PID PROGRAM ARGS...`.

Run as a script by the supervisor. It asks the kernel for SIGTERM at the parent's death, then
becomes the program; the request survives exec. Doing it here, and not between fork and exec of the
supervisor, is safe whatever threads the supervisor has. Standard library only: it runs with -I -S.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1


def main(argv: list[str]) -> None:
    """Become the program."""
    parent_pid, program = int(argv[1]), argv[2:]
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)
    if os.getppid() != parent_pid:
        sys.exit("the parent is gone")
    try:
        os.execvp(program[0], program)
    except OSError as error:
        sys.exit(f"{program[0]} cannot be started: {error.strerror}")


if __name__ == "__main__":
    main(sys.argv)
