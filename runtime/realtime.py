"""Ask the kernel for real-time treatment; take what is permitted and say what is not."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
from dataclasses import dataclass

PR_SET_PDEATHSIG = 1
PR_SET_TIMERSLACK = 29
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4

CONTROL_PRIORITY = 60
"""SCHED_FIFO priority of the control process: above the plant, below kernel threads."""
PLANT_PRIORITY = 50


@dataclass(frozen=True, slots=True)
class RealTimeReport:
    """What was granted.

    Attributes:
        scheduler: "fifo" or "other".
        priority: SCHED_FIFO priority, 0 if "other".
        memory_locked: Pages stay in memory once touched.
        gc_frozen: Python's garbage collector is off.
        messages: One sentence per thing that was not granted, with the remedy.
    """

    scheduler: str
    priority: int
    memory_locked: bool
    gc_frozen: bool
    messages: tuple[str, ...]


def configure_real_time(priority: int = CONTROL_PRIORITY, freeze_gc: bool = True) -> RealTimeReport:
    """Make the calling thread a real-time one, as far as this machine permits.

    Call it after everything is loaded and warm, before the first tick.

    Args:
        priority: SCHED_FIFO priority, 1..99.
        freeze_gc: Collect once, then switch the garbage collector off.
    """
    messages: list[str] = []
    granted = _try_fifo(priority, messages)
    locked = _try_lock_memory(messages)
    if freeze_gc:
        gc.collect()
        gc.freeze()
        gc.disable()
    _libc().prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)
    return RealTimeReport(
        scheduler="fifo" if granted else "other",
        priority=priority if granted else 0,
        memory_locked=locked,
        gc_frozen=freeze_gc,
        messages=tuple(messages),
    )


def _try_fifo(priority: int, messages: list[str]) -> bool:
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except (OSError, AttributeError) as error:
        messages.append(
            f"SCHED_FIFO {priority} is not permitted ({error}); loops may wake late. "
            "Allow it with `ulimit -r 99` or an rtprio line in /etc/security/limits.conf."
        )
        return False
    return True


def _try_lock_memory(messages: list[str]) -> bool:
    # ONFAULT: lock what is touched, not the address space that thread stacks reserve.
    if _libc().mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0:
        return True
    messages.append(
        f"Memory cannot be locked ({os.strerror(ctypes.get_errno())}); a page fault may delay a "
        "tick. Allow it with `ulimit -l unlimited`."
    )
    return False


def die_with_parent(parent_pid: int, signal_number: int = signal.SIGTERM) -> bool:
    """Have the kernel send this process a signal when its parent ends.

    Args:
        parent_pid: Who must be the parent; if it is gone already, the signal is sent now.
        signal_number: The signal.

    Returns:
        Whether the kernel took it.
    """
    taken = bool(_libc().prctl(PR_SET_PDEATHSIG, int(signal_number), 0, 0, 0) == 0)
    if os.getppid() != parent_pid:
        os.kill(os.getpid(), signal_number)
    return taken


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
