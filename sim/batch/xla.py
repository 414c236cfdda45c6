"""XLA's thread pool on a CPU: with few threads, a batch waits in it for ever.

XLA's CPU backend runs a loop's parts on a pool with a thread per core, and on 2 cores all of them
wait for each other once a batch has some dozens of robots (jaxlib 0.10.2: 64 robots, no processor
time, every thread in a futex; neither a single-threaded Eigen nor no YNNPACK helped, 8 threads do).
More threads than cores cost nothing here. A GPU does not care.
"""

from __future__ import annotations

import os

VARIABLE = "NPROC"
"""What XLA takes for the number of cores."""
THREADS = 8


def calm_xla() -> None:
    """Give XLA enough threads, unless the environment says how many; before JAX opens a device."""
    if (os.cpu_count() or 1) < THREADS:
        os.environ.setdefault(VARIABLE, str(THREADS))
