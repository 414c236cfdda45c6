"""The doctor's machine checks: real-time rights, stolen CPU, rendering, Java."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

from downbeat.tools.doctor_check import CheckResult, ok, warn
from downbeat.tools.spy import JDK_HINT

STEAL_WATCH_S = 0.5
STEAL_LIMIT = 0.005
"""Runs with 0.6 % stolen time had wake-ups of 23-44 ms even with SCHED_FIFO, 0.1 % had none."""
WANTED_MEMLOCK_BYTES = 2 << 30
HEAVY_MODULES = ("jax", "torch", "mujoco", "librosa", "matplotlib")

_TRY_FIFO = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
_TRY_GL = "import mujoco; c = mujoco.GLContext(64, 64); c.make_current(); c.free()"
_LIST_HEAVY = (
    f"import sys, downbeat.control.node\nprint(*[m for m in {HEAVY_MODULES!r} if m in sys.modules])"
)


def check_scheduling() -> CheckResult:
    """SCHED_FIFO should be permitted; tried in a child process."""
    tried = subprocess.run(
        [sys.executable, "-S", "-c", _TRY_FIFO], capture_output=True, check=False
    )
    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if tried.returncode == 0:
        return ok("scheduling", f"SCHED_FIFO permitted (rtprio limit {limit})")
    return warn(
        "scheduling",
        "SCHED_FIFO not permitted: under load a tick can be 70 ms late",
        "ulimit -r 99, or an rtprio line in /etc/security/limits.conf",
    )


def check_rt_throttling(
    runtime_file: Path = Path("/proc/sys/kernel/sched_rt_runtime_us"),
) -> CheckResult:
    """A runaway real-time loop should not freeze the machine."""
    try:
        runtime_us = int(runtime_file.read_text())
    except OSError:
        return ok("rt throttling", "not known on this kernel")
    if runtime_us < 0:
        return warn(
            "rt throttling",
            "off: a runaway real-time loop freezes the machine",
            "sysctl -w kernel.sched_rt_runtime_us=950000",
        )
    return ok("rt throttling", f"real-time loops get at most {runtime_us} us per second")


def check_memory_lock() -> CheckResult:
    """Control's pages should stay in memory."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    is_free = limit == resource.RLIM_INFINITY or os.geteuid() == 0
    if is_free or limit >= WANTED_MEMLOCK_BYTES:
        return ok("memory lock", "permitted")
    return warn(
        "memory lock",
        f"at most {limit} bytes: a page fault may delay a tick",
        "ulimit -l unlimited",
    )


def check_governor(
    governor_file: Path = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
) -> CheckResult:
    """The CPU should not have to speed up first."""
    try:
        governor = governor_file.read_text().strip()
    except OSError:
        return ok("cpu governor", "not visible (virtual machine)")
    if governor == "performance":
        return ok("cpu governor", governor)
    return warn("cpu governor", governor, "cpupower frequency-set -g performance")


def check_steal(stat_file: Path = Path("/proc/stat")) -> CheckResult:
    """Time that the hypervisor takes away cannot be won back by any priority."""
    before = cpu_times(stat_file.read_text())
    time.sleep(STEAL_WATCH_S)
    after = cpu_times(stat_file.read_text())
    total = max(1, sum(after) - sum(before))
    stolen = (after[7] - before[7]) / total
    busy = 1.0 - (after[3] - before[3] + after[4] - before[4]) / total
    detail = f"{100 * stolen:.1f} % stolen, {100 * busy:.0f} % busy"
    if stolen <= STEAL_LIMIT:
        return ok("stolen cpu", detail)
    return warn("stolen cpu", detail, "Use a machine of its own, or `downbeat demo --lockstep`.")


def cpu_times(stat: str) -> list[int]:
    """Return user, nice, system, idle, iowait, irq, softirq, steal of /proc/stat [ticks]."""
    numbers = [int(number) for number in stat.splitlines()[0].split()[1:9]]
    return numbers + [0] * (8 - len(numbers))


def check_control_imports() -> CheckResult:
    """The control process must not carry a heavy library: its garbage collector would pay."""
    listed = subprocess.run(
        [sys.executable, "-c", _LIST_HEAVY], capture_output=True, text=True, check=False
    )
    if listed.returncode != 0:
        reason = (listed.stderr.strip().splitlines() or ["no message"])[-1]
        return CheckResult("control imports", "fail", reason, "Install Downbeat again: make setup")
    heavy = listed.stdout.split()
    if heavy:
        return warn("control imports", ", ".join(heavy), "Report this.")
    return ok("control imports", "none of " + ", ".join(HEAVY_MODULES))


def check_rendering() -> CheckResult:
    """Video and viewer need GL; nothing else does."""
    for backend in ("egl", "osmesa"):
        tried = subprocess.run(
            [sys.executable, "-c", _TRY_GL],
            env={**os.environ, "MUJOCO_GL": backend},
            capture_output=True,
            check=False,
        )
        if tried.returncode == 0:
            return ok("rendering", backend)
    return warn(
        "rendering",
        "neither EGL nor OSMesa: no video.mp4",
        "apt-get install libegl1 libgl1-mesa-dri (or libosmesa6)",
    )


def check_java() -> CheckResult:
    """Only lcm-spy needs Java."""
    missing = [name for name in ("java", "javac") if shutil.which(name) is None]
    if missing:
        return warn("java", f"no {' and no '.join(missing)}: no lcm-spy", JDK_HINT)
    return ok("java", "present")
