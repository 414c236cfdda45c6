"""What a process costs: processor time and memory, carried in the detail of its heartbeat."""

from __future__ import annotations

import re
import resource
import time
from dataclasses import dataclass
from pathlib import Path

PAGE_KB = resource.getpagesize() // 1024
_PATTERN = re.compile(r"\[cpu (\d+\.\d+) s, memory (\d+) KiB\]")


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process has used.

    Attributes:
        cpu_s: Processor time of all its threads since its start [s].
        memory_kb: Resident memory now [KiB].
    """

    cpu_s: float
    memory_kb: int

    def text(self) -> str:
        """Return it for a heartbeat; `usage_in` reads it back."""
        return f"[cpu {self.cpu_s:.3f} s, memory {self.memory_kb} KiB]"


def own_usage() -> Usage:
    """Measure the calling process; about 10 us."""
    resident = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return Usage(time.process_time(), resident * PAGE_KB)


def usage_in(detail: str) -> Usage | None:
    """Return what a heartbeat's detail says, None if it does not."""
    found = _PATTERN.search(detail)
    return None if found is None else Usage(float(found[1]), int(found[2]))
