"""The yardstick for our loop: an absolute-deadline loop in C, built on the spot.

What a C program with the same rights reaches on this machine is the best that a loop of ours could
do; their ratio says what Python costs, whatever the machine's own noise is.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from downbeat.tools.errors import ToolError

COMPILERS = ("cc", "gcc", "clang")
NO_COMPILER = (
    "There is no C compiler (cc, gcc or clang) on the PATH, so the C loop is left out; "
    "`apt install gcc` brings one."
)

SOURCE = r"""
#define _GNU_SOURCE
#include <inttypes.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/* Arguments: first deadline [ns of CLOCK_MONOTONIC], period [ns], wake-ups, priority, processor
   (-1: any). Prints "fifo locked missed", then the lateness of every wake-up [ns]. */
int main(int argc, char **argv)
{
    if (argc != 6)
        return 2;
    int64_t deadline = atoll(argv[1]), period = atoll(argv[2]);
    int count = atoi(argv[3]), cpu = atoi(argv[5]);
    int64_t *late = calloc(count, sizeof *late);
    int64_t missed = 0;
    if (late == NULL)
        return 1;
    if (cpu >= 0) {
        cpu_set_t set;
        CPU_ZERO(&set);
        CPU_SET(cpu, &set);
        sched_setaffinity(0, sizeof set, &set);
    }
    struct sched_param param = {.sched_priority = atoi(argv[4])};
    int fifo = sched_setscheduler(0, SCHED_FIFO, &param) == 0;
    int locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    prctl(PR_SET_TIMERSLACK, 1UL);
    for (int i = 0; i < count; i++) {
        int64_t behind = (now_ns() - deadline) / period;
        if (behind > 0) {
            missed += behind;
            deadline += behind * period;
        }
        struct timespec t = {deadline / 1000000000, deadline % 1000000000};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
        late[i] = now_ns() - deadline;
        deadline += period;
    }
    printf("%d %d %" PRId64 "\n", fifo, locked, missed);
    for (int i = 0; i < count; i++)
        printf("%" PRId64 "\n", late[i]);
    free(late);
    return 0;
}
"""


@dataclass(frozen=True)
class LoopResult:
    """What one run of the C loop measured.

    Attributes:
        lateness_us: Of each wake-up [us].
        missed: Deadlines given up.
        scheduler: "fifo" or "other".
    """

    lateness_us: list[float]
    missed: int
    scheduler: str


def build_loop(cache: Path) -> Path | None:
    """Compile the loop once per version of its source; None without a compiler.

    Args:
        cache: Folder for the program.

    Raises:
        ToolError: The compiler refuses it.
    """
    program = cache / f"loop-{hashlib.sha256(SOURCE.encode()).hexdigest()[:16]}"
    if program.is_file():
        return program
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        return None
    cache.mkdir(parents=True, exist_ok=True)
    source = cache / f"{program.name}.c"
    source.write_text(SOURCE, encoding="utf-8")
    fresh = cache / f"{program.name}.{os.getpid()}"
    result = subprocess.run(
        [compiler, "-O2", "-o", fresh, source], capture_output=True, text=True, check=False
    )
    if result.returncode != 0:
        said = (result.stderr.strip().splitlines() or ["no message"])[0]
        raise ToolError(f"The C loop {source} does not compile with {compiler}: {said}.")
    fresh.replace(program)
    return program


def run_loop(
    program: Path, first_ns: int, period_ns: int, count: int, priority: int, cpu: int | None
) -> LoopResult:
    """Run the loop and wait for its end.

    Args:
        program: From `build_loop`.
        first_ns: First deadline on CLOCK_MONOTONIC [ns].
        period_ns: Between deadlines [ns].
        count: Wake-ups.
        priority: SCHED_FIFO priority, taken if permitted.
        cpu: Processor to run on; None: any.

    Raises:
        ToolError: It fails.
    """
    numbers = (first_ns, period_ns, count, priority, -1 if cpu is None else cpu)
    result = subprocess.run(
        [program, *(str(number) for number in numbers)], capture_output=True, text=True, check=False
    )
    if result.returncode != 0:
        raise ToolError(f"The C loop {program} ended with {result.returncode}.")
    first, *lines = result.stdout.splitlines()
    is_fifo, _locked, missed = (int(word) for word in first.split())
    lateness_us = [int(line) * 1e-3 for line in lines]
    return LoopResult(lateness_us, missed, "fifo" if is_fifo else "other")
