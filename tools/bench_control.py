"""`downbeat bench control`: our loop, a C loop and the bare network, interleaved, idle and loaded.

Blocks run one at a time in the order A B C C B A, idle first and last, loaded in between, so that
whatever else the machine does falls on all of them alike.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from downbeat.control.phase import TICK_US
from downbeat.policies.manifest import load_skills
from downbeat.runtime import child
from downbeat.runtime.clock import TimeBase, WallClock
from downbeat.runtime.config import plain
from downbeat.runtime.errors import one_of
from downbeat.tools.bench_control_report import Block, print_report, report_of
from downbeat.tools.bench_control_world import BenchSettings
from downbeat.tools.errors import ToolError
from downbeat.tools.loop_c import NO_COMPILER, build_loop, run_loop
from downbeat.tools.processes import CONTROL_PRIORITY
from downbeat.tools.rundir import CACHE_DIR

WORLD_PRIORITY = CONTROL_PRIORITY - 10
PROGRAMS = ("control", "c", "network", "warm")
SHARES = {"control": 1.0, "network": 0.4, "warm": 0.5}
"""Of a block's length; percentiles of a run settle sooner than those of a wake-up. A warm tick is
no sleep, so its blocks are over in a fraction of that."""
SHORTEST_S = 0.1
LOAD_SETTLES_S = 0.3


@dataclass(frozen=True)
class ControlBench:
    """What to run.

    Attributes:
        seconds: Of control, and of the C loop, in each state [s]; two blocks each.
        load: Also run everything beside one busy loop per processor.
        skill: A planted skill to play.
        url: LCM URL; empty: a free port of a group of the bench's own, on this machine only.
        cpu: Processor of control and of the C loop; None: any.
        cache: Folder for the C program.
    """

    seconds: float = 14.0
    load: bool = True
    skill: str = "kpop"
    url: str = ""
    cpu: int | None = None
    cache: Path = CACHE_DIR

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            ToolError: One is impossible.
        """
        planted = [name for name, skill in load_skills().items() if skill.kind == "planted"]
        if self.skill == "stand" or self.skill not in planted:
            raise ToolError(
                f"The bench cannot play '{self.skill}': it needs a planted skill that is not "
                f"stand, and those are {one_of(set(planted) - {'stand'})} (--skill)."
            )
        if not self.seconds > 0.0:
            raise ToolError(f"The bench cannot run for {self.seconds:g} s (--seconds).")
        allowed = os.sched_getaffinity(0)
        if self.cpu is not None and self.cpu not in allowed:
            raise ToolError(f"Processor {self.cpu} is not one of {one_of(allowed)} (--cpu).")

    def order(self) -> list[tuple[bool, tuple[str, ...]]]:
        """Return (loaded, programs) in the order in which they run."""
        back = PROGRAMS[::-1]
        if not self.load:
            return [(False, PROGRAMS), (False, back)]
        return [(False, PROGRAMS), (True, back), (True, PROGRAMS), (False, back)]


class Helper:
    """A process of the bench that speaks lines of JSON; it dies with us."""

    def __init__(self, module: str, settings: Path) -> None:
        """Start it and wait until it is ready.

        Raises:
            ToolError: It ended instead.
        """
        self._name = module.rpartition("_")[2]
        self._process = subprocess.Popen(
            _with_parent(sys.executable, "-m", module, str(settings)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.read()

    def ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """Send one line and return the answer."""
        if self._process.stdin is not None:
            self._process.stdin.write(json.dumps(question) + "\n")
            self._process.stdin.flush()
        return self.read()

    def read(self) -> dict[str, Any]:
        """Return the next line.

        Raises:
            ToolError: The process ended instead.
        """
        line = self._process.stdout.readline() if self._process.stdout else ""
        if not line:
            code = self._process.wait()
            raise ToolError(
                f"The bench's {self._name} process ended with {code}; its output is above."
            )
        answer: dict[str, Any] = json.loads(line)
        return answer

    def terminate(self) -> None:
        """Ask it to stop; `read` then returns its last words."""
        self._process.terminate()

    def close(self) -> None:
        """End it, whatever it does."""
        if self._process.stdin:
            self._process.stdin.close()
        try:
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout:
            self._process.stdout.close()


def _with_parent(*argv: str) -> list[str]:
    return [sys.executable, "-I", "-S", child.__file__, str(os.getpid()), *argv]


@contextmanager
def busy_processors() -> Iterator[None]:
    """Keep every processor busy at normal priority; always ends what it started."""
    burners: list[subprocess.Popen[bytes]] = []
    try:
        for _ in os.sched_getaffinity(0):
            argv = _with_parent(sys.executable, "-I", "-S", "-c", "while True: pass")
            burners.append(subprocess.Popen(argv, stdin=subprocess.DEVNULL))
        time.sleep(LOAD_SETTLES_S)
        yield
    finally:
        for burner in burners:
            burner.kill()
        for burner in burners:
            burner.wait()


def measure(bench: ControlBench) -> dict[str, Any]:
    """Run everything and return the report, ready for JSON.

    Raises:
        ToolError: A process of the bench failed.
        MulticastError: This machine does not carry multicast.
    """
    base = TimeBase.now()
    settings = BenchSettings(
        url=bench.url or free_url(),
        skill=bench.skill,
        epoch_utime=base.epoch_utime,
        epoch_monotonic_ns=base.epoch_monotonic_ns,
        priority=CONTROL_PRIORITY,
        world_priority=WORLD_PRIORITY,
        cpu=-1 if bench.cpu is None else bench.cpu,
    )
    loop = build_loop(bench.cache)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        path = folder / "settings.toml"
        text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in plain(settings).items())
        path.write_text(text, encoding="utf-8")
        worker = Helper("downbeat.tools.bench_control_worker", path)
        stack.callback(worker.close)
        world = Helper("downbeat.tools.bench_control_world", path)
        stack.callback(world.close)
        runner = _Runner(bench, settings, loop, worker)
        for loaded, programs in bench.order():
            with busy_processors() if loaded else ExitStack():
                for program in programs:
                    runner.run(program, loaded)
        world.terminate()
        answers = [(int(a), int(b)) for a, b in world.read()["answers"]]
    messages = list(runner.messages) + ([NO_COMPILER] if loop is None else [])
    return report_of(runner.blocks, answers, messages, runner.granted)


class _Runner:
    """Runs blocks and collects them."""

    def __init__(
        self, bench: ControlBench, settings: BenchSettings, loop: Path | None, worker: Helper
    ) -> None:
        self._bench = bench
        self._settings = settings
        self._loop = loop
        self._worker = worker
        self.blocks: list[Block] = []
        self.messages: tuple[str, ...] = ()
        self.granted: dict[str, Any] = {}

    def run(self, program: str, loaded: bool) -> None:
        """Run one block of a program."""
        seconds = max(0.5 * self._bench.seconds, SHORTEST_S)
        if program == "c":
            if self._loop is not None:
                self.blocks.append(self._run_c(self._loop, seconds, loaded))
            return
        seconds = max(SHARES[program] * seconds, SHORTEST_S)
        answer = self._worker.ask({"kind": program, "seconds": seconds})
        self.granted = answer.pop("granted")
        self.messages = tuple(self.granted.pop("messages"))
        self.blocks.append(Block(loaded=loaded, **answer))

    def _run_c(self, loop: Path, seconds: float, loaded: bool) -> Block:
        settings = self._settings
        clock: WallClock = settings.clock
        start = clock.utime()
        # The same grid as control's: what the world does at those moments meets both.
        first = (start // TICK_US + 2) * TICK_US
        first_ns = time.monotonic_ns() + (first - clock.utime()) * 1000
        count = max(1, round(seconds * 1e6) // TICK_US)
        cpu = None if settings.cpu < 0 else settings.cpu
        result = run_loop(loop, first_ns, TICK_US * 1000, count, settings.priority, cpu)
        return Block("c", loaded, start, clock.utime(), result.lateness_us, missed=result.missed)


def free_url() -> str:
    """Return a URL of a group of our own, with a port that nobody has bound."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = min(int(probe.getsockname()[1]), 65_000)
    return f"udpm://239.255.76.68:{port}?ttl=0"


def bench_control(bench: ControlBench, as_json: bool) -> int:
    """Measure and print."""
    report = measure(bench)
    if as_json:
        print(json.dumps(report, allow_nan=False))
    else:
        print_report(report, Console())
    return 0
