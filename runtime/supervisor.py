"""The supervisor: one process table, one loop at 2 Hz and on every child's exit."""

from __future__ import annotations

import logging
import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from downbeat.runtime.errors import one_of
from downbeat.runtime.process import (
    Conditions,
    CrashPolicy,
    ManagedProcess,
    ProcessError,
    ProcessSpec,
    ProcessState,
)

log = logging.getLogger("downbeat.supervisor")

LOOP_PERIOD_S = 0.5
STOP_POLL_S = 0.05


@dataclass(frozen=True, slots=True)
class SupervisorReport:
    """How a supervised run ended.

    Attributes:
        is_good: No process made the show end.
        reason: One sentence.
        processes: The table at the end.
    """

    is_good: bool
    reason: str
    processes: tuple[ProcessState, ...]


class Supervisor:
    """Starts, watches and stops the processes of a table.

    Use it from the main thread: the kernel ends the children when the starting thread ends.
    """

    def __init__(self, specs: Sequence[ProcessSpec]) -> None:
        """Take a process table; nothing starts yet.

        Raises:
            ProcessError: A name occurs twice, or a command is empty.
        """
        names = [spec.name for spec in specs]
        for spec in specs:
            if names.count(spec.name) > 1:
                raise ProcessError(f"Process {spec.name!r} occurs twice in the process table.")
            if not spec.argv:
                raise ProcessError(f"Process {spec.name!r} has no command.")
        self._processes = [ManagedProcess(spec) for spec in specs]
        self._restart_at_s: dict[str, float] = {}
        self._conditions: Conditions = frozenset()
        self.end_reason = ""
        """Why the show has to end; empty while it goes on."""

    def set_conditions(self, conditions: Conditions) -> None:
        """Say which conditions hold; processes start and stop accordingly at the next step."""
        self._conditions = conditions

    def step(self, timeout_s: float = LOOP_PERIOD_S) -> bool:
        """Do one round: start and stop what should be, wait for exits or the timeout, judge them.

        Returns:
            Whether the show goes on.
        """
        for process in self._processes:
            self._start_or_stop(process)
        self._wait(timeout_s)
        for process in self._processes:
            process.enforce_stop()
            if process.poll():
                self._judge_exit(process)
        return not self.end_reason

    def _start_or_stop(self, process: ManagedProcess) -> None:
        spec = process.spec
        should_run = spec.should_run(self._conditions)
        if not should_run:
            process.stop()
        elif not process.is_running and self._may_start(process):
            process.start()
            log.info("started %s", spec.name)

    def _may_start(self, process: ManagedProcess) -> bool:
        """Whether it never ran, was stopped by its predicate, or waits for a restart."""
        name = process.spec.name
        if process.exit_code is None or process.is_stopping:
            return True
        if name in self._restart_at_s and time.monotonic() >= self._restart_at_s[name]:
            del self._restart_at_s[name]
            process.restarts += 1
            return True
        return False

    def _wait(self, timeout_s: float) -> None:
        """Sleep until a child exits, the next restart, or the timeout."""
        waits = [at - time.monotonic() for at in self._restart_at_s.values()]
        if any(process.is_stopping for process in self._processes if process.is_running):
            waits.append(STOP_POLL_S)
        poller = select.poll()
        for process in self._processes:
            if process.is_running:
                poller.register(process.pidfd, select.POLLIN)
        poller.poll(max(0.0, min([timeout_s, *waits])) * 1000)

    def _judge_exit(self, process: ManagedProcess) -> None:
        spec = process.spec
        log.info("%s ended with %s", spec.name, process.exit_code)
        if not process.has_failed:
            return
        policy = spec.crash_policy
        if policy is CrashPolicy.STOP_ALL:
            self._end(f"{spec.name} ended with {process.exit_code}")
        elif policy is CrashPolicy.RESTART:
            if process.restarts >= spec.max_restarts:
                self._end(
                    f"{spec.name} ended with {process.exit_code} after {process.restarts} restarts"
                )
            else:
                self._restart_at_s[spec.name] = time.monotonic() + spec.restart_delay_s
                log.warning("%s ended with %s, restarting", spec.name, process.exit_code)

    def _end(self, reason: str) -> None:
        if not self.end_reason:
            self.end_reason = reason
            log.error("ending: %s", reason)

    def snapshot(self) -> tuple[ProcessState, ...]:
        """Return the live table, in the order of the process table."""
        return tuple(
            process.state(process.spec.should_run(self._conditions)) for process in self._processes
        )

    def state_of(self, name: str) -> ProcessState:
        """Return one line of the live table.

        Raises:
            ProcessError: There is no such process.
        """
        for state in self.snapshot():
            if state.name == name:
                return state
        known = one_of(process.spec.name for process in self._processes)
        raise ProcessError(f"There is no process {name!r} in the process table; it has {known}.")

    def stop_all(self) -> None:
        """Stop everything: the polite signal in reverse order, then, after its time, the kill."""
        for process in reversed(self._processes):
            process.stop()
        while any(process.is_running for process in self._processes):
            self._wait(STOP_POLL_S)
            for process in self._processes:
                process.enforce_stop()
                process.poll()

    def run(
        self,
        should_stop: Callable[[], bool],
        on_change: Callable[[tuple[ProcessState, ...]], None] | None = None,
    ) -> SupervisorReport:
        """Run the table until `should_stop` or a process ends the show; stops all on the way out.

        Args:
            should_stop: Asked once per round.
            on_change: Called once per round with the live table.
        """
        try:
            while self.step():
                if on_change is not None:
                    on_change(self.snapshot())
                if should_stop():
                    break
        finally:
            self.stop_all()
        reason = self.end_reason or "stopped as asked"
        return SupervisorReport(not self.end_reason, reason, self.snapshot())
