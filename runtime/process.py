"""A row of the process table, and one running child."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from downbeat.runtime import child
from downbeat.runtime.clock import TimeBase
from downbeat.runtime.errors import DownbeatError

CLI_MODULE = "downbeat.tools.cli"


class ProcessError(DownbeatError):
    """A process table that is not valid, or a program that cannot be started."""


class CrashPolicy(Enum):
    """What the supervisor does when a process ends with an error."""

    RESTART = "restart"
    """Start it again, at most `max_restarts` times."""
    STOP_ALL = "stop_all"
    """End the show."""
    NEVER = "never"
    """Leave it down; the others go on."""


Conditions = frozenset[str]
Predicate = Callable[[Conditions], bool]
"""When a process should run, given the names of the conditions that hold now."""


def always(_conditions: Conditions) -> bool:
    """Run from start to end."""
    return True


def when(condition: str) -> Predicate:
    """Run while a condition holds."""
    return lambda conditions: condition in conditions


def both(first: Predicate, second: Predicate) -> Predicate:
    """Run while both say so."""
    return lambda conditions: first(conditions) and second(conditions)


def either(first: Predicate, second: Predicate) -> Predicate:
    """Run while one says so."""
    return lambda conditions: first(conditions) or second(conditions)


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """One row of the process table.

    Attributes:
        name: Process name.
        argv: Program and arguments; see `cli_argv`.
        crash_policy: What happens when it ends with an error.
        should_run: When it should run.
        max_restarts: Restarts before the supervisor gives up and ends the show.
        restart_delay_s: Pause before a restart [s].
        stop_timeout_s: Time between the polite signal and the kill [s].
        log_path: Where its output goes; None: the supervisor's own.
    """

    name: str
    argv: tuple[str, ...]
    crash_policy: CrashPolicy = CrashPolicy.STOP_ALL
    should_run: Predicate = always
    max_restarts: int = 5
    restart_delay_s: float = 0.5
    stop_timeout_s: float = 5.0
    log_path: Path | None = None


def cli_argv(subcommand: str, *arguments: str, base: TimeBase | None = None) -> tuple[str, ...]:
    """Command of one of our own processes, with the show's time base."""
    time_base: tuple[str, ...] = ()
    if base is not None:
        time_base = (
            "--epoch-utime",
            str(base.epoch_utime),
            "--epoch-monotonic-ns",
            str(base.epoch_monotonic_ns),
        )
    return (sys.executable, "-m", CLI_MODULE, subcommand, *arguments, *time_base)


@dataclass(frozen=True, slots=True)
class ProcessState:
    """One line of the live table.

    Attributes:
        name: Process name.
        state: "waiting", "running", "stopping", "done", "failed" or "killed".
        should_run: What the table wants.
        pid: Process id; 0 if it does not run.
        exit_code: Of the last end, negative: by that signal; None: never ended.
        restarts: How often it was started again.
        uptime_s: Since its last start [s]; 0 if it does not run.
    """

    name: str
    state: str
    should_run: bool
    pid: int
    exit_code: int | None
    restarts: int
    uptime_s: float


class ManagedProcess:
    """One child of the supervisor."""

    def __init__(self, spec: ProcessSpec) -> None:
        self.spec = spec
        self.restarts = 0
        self.exit_code: int | None = None
        self.pidfd = -1
        self._popen: subprocess.Popen[bytes] | None = None
        self._started_s = 0.0
        self._stop_asked_s = 0.0
        self._was_killed = False

    @property
    def is_running(self) -> bool:
        """Whether the child exists."""
        return self._popen is not None

    @property
    def is_stopping(self) -> bool:
        """Whether it was told to stop."""
        return self._stop_asked_s > 0.0

    @property
    def has_failed(self) -> bool:
        """Whether its last end was an error that nobody asked for."""
        return self.exit_code not in (None, 0) and not self.is_stopping

    def start(self) -> None:
        """Spawn it; it gets SIGTERM when the calling thread's process dies.

        Raises:
            ProcessError: Its output file cannot be opened.
        """
        # A session of its own: Ctrl-C reaches the supervisor only, which then stops all politely.
        wrapper = [sys.executable, "-I", "-S", child.__file__, str(os.getpid())]
        output = None
        try:
            if self.spec.log_path is not None:
                output = self.spec.log_path.open("ab")
            self._popen = subprocess.Popen(
                [*wrapper, *self.spec.argv],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=None if output is None else subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            raise ProcessError(
                f"Process {self.spec.name!r} cannot be started: {error.strerror} "
                f"({error.filename})."
            ) from error
        finally:
            if output is not None:
                output.close()
        self.pidfd = os.pidfd_open(self._popen.pid)
        self._started_s = time.monotonic()
        self._stop_asked_s = 0.0
        self._was_killed = False
        self.exit_code = None

    def poll(self) -> bool:
        """Reap it if it ended; return whether it just did."""
        if self._popen is None or self._popen.poll() is None:
            return False
        self.exit_code = self._popen.returncode
        self._popen = None
        os.close(self.pidfd)
        self.pidfd = -1
        return True

    def stop(self) -> None:
        """Ask it to stop; call `enforce_stop` until it has."""
        if self._popen is not None and not self.is_stopping:
            self._stop_asked_s = time.monotonic()
            self._signal(signal.SIGTERM)

    def enforce_stop(self) -> None:
        """Kill it if it was asked to stop too long ago."""
        if self._popen is None or not self.is_stopping or self._was_killed:
            return
        if time.monotonic() - self._stop_asked_s > self.spec.stop_timeout_s:
            self._was_killed = True
            self._signal(signal.SIGKILL)

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self.pidfd, number)

    def state(self, should_run: bool) -> ProcessState:
        """Describe it for the live table."""
        is_running = self._popen is not None
        return ProcessState(
            name=self.spec.name,
            state=self._state_name(),
            should_run=should_run,
            pid=self._popen.pid if self._popen is not None else 0,
            exit_code=self.exit_code,
            restarts=self.restarts,
            uptime_s=time.monotonic() - self._started_s if is_running else 0.0,
        )

    def _state_name(self) -> str:
        if self._popen is not None:
            return "stopping" if self.is_stopping else "running"
        if self.exit_code is None:
            return "waiting"
        if self._was_killed:
            return "killed"
        return "failed" if self.has_failed else "done"
