"""Ask the kernel for real-time treatment; take what is permitted and say what is not."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import threading
from contextlib import suppress
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
        cpus: The processors that the process may use.
        memory_locked: Pages stay in memory once touched.
        gc_frozen: Python's garbage collector is off.
        messages: One sentence per thing that was not granted, with the remedy.
    """

    scheduler: str
    priority: int
    cpus: tuple[int, ...]
    memory_locked: bool
    gc_frozen: bool
    messages: tuple[str, ...]


def configure_real_time(
    priority: int = CONTROL_PRIORITY, freeze_gc: bool = True, cpu: int | None = None
) -> RealTimeReport:
    """Make the calling process a real-time one, as far as this machine permits.

    Call it from the main thread after everything is loaded and warm and every channel subscribed,
    before the first tick: threads that start later run without the right.

    Args:
        priority: SCHED_FIFO priority, 1..99.
        freeze_gc: Collect once, then switch the garbage collector off.
        cpu: Pin the process to this processor; None: to none.
    """
    messages: list[str] = []
    if cpu is not None:
        _try_pin(cpu, messages)
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
        cpus=tuple(sorted(os.sched_getaffinity(0))),
        memory_locked=locked,
        gc_frozen=freeze_gc,
        messages=tuple(messages),
    )


def _other_threads() -> list[int]:
    """Return the thread ids of this process without the caller's."""
    own = threading.get_native_id()
    return [int(name) for name in os.listdir("/proc/self/task") if int(name) != own]


def _try_pin(cpu: int, messages: list[str]) -> None:
    try:
        os.sched_setaffinity(0, {cpu})
        for thread in _other_threads():
            with suppress(ProcessLookupError):
                os.sched_setaffinity(thread, {cpu})
    except (OSError, ValueError) as error:
        allowed = ", ".join(str(number) for number in sorted(os.sched_getaffinity(0)))
        messages.append(f"Processor {cpu} cannot be used ({error}); valid are {allowed}.")


def _try_fifo(priority: int, messages: list[str]) -> bool:
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
        # LCM reads the socket in a thread of its own and shares a lock with us: left behind, it
        # starves on a busy machine, and messages wait in the kernel while ticks find none.
        for thread in _other_threads():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(thread, policy, os.sched_param(priority))
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
