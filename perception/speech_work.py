"""Slow work beside a process's loop: recognising, asking a service, speaking.

On a real clock it runs in one thread, so that nothing blocks the ears; on simulated time it runs at
once, and its result arrives after a fixed delay, so that a run is the same every time.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

MAX_WAITING = 4
"""Utterances that may wait; more are dropped: a late answer is worse than none."""


@dataclass(frozen=True, slots=True)
class Done:
    """A finished job: its name and what it returned, or how it failed."""

    name: str
    result: Any
    failure: str = ""


class Worker(Protocol):
    """Does jobs in their order."""

    def submit(self, name: str, job: Callable[[], Any], utime: int) -> bool:
        """Take a job; False if too many wait."""
        ...

    def done(self, utime: int) -> list[Done]:
        """Return what has finished."""
        ...

    def close(self) -> None:
        """Take no more; a running job is not waited for."""
        ...


def _run(name: str, job: Callable[[], Any]) -> Done:
    try:
        return Done(name, job())
    except Exception as error:  # a backend may do anything; the process lives on
        return Done(name, None, f"{type(error).__name__}: {error}")


class SimulatedWorker:
    """Works at once; results arrive later."""

    def __init__(self, delay_us: int = 150_000) -> None:
        """Begin idle.

        Args:
            delay_us: From a job to its result [us].
        """
        self._delay_us = delay_us
        self._waiting: list[tuple[int, Done]] = []

    def submit(self, name: str, job: Callable[[], Any], utime: int) -> bool:
        """Work."""
        if len(self._waiting) >= MAX_WAITING:
            return False
        self._waiting.append((utime + self._delay_us, _run(name, job)))
        return True

    def done(self, utime: int) -> list[Done]:
        """Return what is due."""
        due = [done for at, done in self._waiting if at <= utime]
        self._waiting = [(at, done) for at, done in self._waiting if at > utime]
        return due

    def close(self) -> None:
        """Nothing runs."""


class ThreadWorker:
    """Works in one thread."""

    def __init__(self) -> None:
        self._jobs: queue.Queue[tuple[str, Callable[[], Any]] | None] = queue.Queue()
        self._results: queue.Queue[Done] = queue.Queue()
        self._thread = threading.Thread(target=self._loop, name="speech work", daemon=True)
        self._thread.start()

    def _loop(self) -> None:
        while (job := self._jobs.get()) is not None:
            self._results.put(_run(*job))

    def submit(self, name: str, job: Callable[[], Any], utime: int) -> bool:
        """Hand a job to the thread."""
        if self._jobs.qsize() >= MAX_WAITING:
            return False
        self._jobs.put((name, job))
        return True

    def done(self, utime: int) -> list[Done]:
        """Return what has finished."""
        found = []
        while True:
            try:
                found.append(self._results.get_nowait())
            except queue.Empty:
                return found

    def close(self) -> None:
        """End the thread after what it does now."""
        self._jobs.put(None)
