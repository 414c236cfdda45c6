"""What a run folder says about the run's cost: log, heartbeats, journal, the processes' output."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.lcm_types import heartbeat_t
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.codec import CodecError, codec_for
from downbeat.runtime.endpoint import HEAD
from downbeat.runtime.log import read_events
from downbeat.runtime.usage import usage_in
from downbeat.tools.control_journal import JOURNAL_NAME
from downbeat.tools.errors import ToolError
from downbeat.tools.runlog import LOG_NAME

F64 = NDArray[np.float64]
LOGS_NAME = "logs"
DECODED = ("CONTROL_STATUS", "HEARTBEAT")


@dataclass(frozen=True)
class ProcessTimes:
    """What a process's heartbeats said.

    Attributes:
        elapsed_s: Since its first one, (n,) [s].
        cpu_s: Processor time so far, (n,) [s].
        memory_mb: Resident, (n,) [MB].
        log_lines: Lines of its own output.
        duration_s: Of the run [s].
    """

    elapsed_s: F64
    cpu_s: F64
    memory_mb: F64
    log_lines: int
    duration_s: float


@dataclass
class ChannelTimes:
    """The messages of one channel with a rate.

    Attributes:
        name: Channel.
        count: Messages in the log.
        lost: Sequence numbers missing between them.
        gaps_us: Between neighbours of one publisher, by their stamps, (n,) [us].
    """

    name: str
    count: int = 0
    lost: int = 0
    gaps_us: F64 = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class RunCosts:
    """Everything that budgets need.

    Attributes:
        processes: By name; those with heartbeats or output of their own.
        channels: By name; those with a rate that are in the log.
        lateness_us: Of control's ticks, (n,) [us].
        compute_us: The same [us].
        missed: Ticks given up.
        duration_s: From the log's first message to its last [s].
        log_bytes: Size of the log.
        journal_bytes: Size of the journal.
    """

    processes: dict[str, ProcessTimes]
    channels: dict[str, ChannelTimes]
    lateness_us: F64
    compute_us: F64
    missed: int
    duration_s: float
    log_bytes: int
    journal_bytes: int


def read_costs(run_dir: Path) -> RunCosts:
    """Read a run folder.

    Raises:
        DownbeatError: There is no log, or it is empty.
    """
    path = run_dir / LOG_NAME
    first_utime = last_utime = 0
    heads: dict[tuple[str, int], list[tuple[int, int]]] = defaultdict(list)
    messages: dict[str, list[Any]] = defaultdict(list)
    codecs = {name: codec_for(CHANNELS[name].type) for name in DECODED}
    for event in read_events(path):
        row = CHANNELS.get(event.channel)
        if row is None or len(event.payload) < HEAD.size:
            continue
        first_utime = first_utime or event.utime
        last_utime = event.utime
        if row.rate_hz:
            _fingerprint, utime, seq, epoch = HEAD.unpack_from(event.payload)
            heads[event.channel, epoch].append((utime, seq))
        if event.channel in codecs:
            try:
                messages[event.channel].append(codecs[event.channel].decode(event.payload))
            except CodecError:
                continue
    if not first_utime:
        raise ToolError(f"The log {path} holds no message of ours.")
    duration_s = (last_utime - first_utime) * 1e-6
    ticks = messages["CONTROL_STATUS"]
    journal = run_dir / JOURNAL_NAME
    return RunCosts(
        processes=_processes(messages["HEARTBEAT"], run_dir / LOGS_NAME, duration_s),
        channels=_channels(heads),
        lateness_us=np.array([tick.lateness_us for tick in ticks], np.float64),
        compute_us=np.array([tick.compute_us for tick in ticks], np.float64),
        missed=max((tick.missed for tick in ticks), default=0),
        duration_s=duration_s,
        log_bytes=path.stat().st_size,
        journal_bytes=journal.stat().st_size if journal.is_file() else 0,
    )


def _channels(heads: dict[tuple[str, int], list[tuple[int, int]]]) -> dict[str, ChannelTimes]:
    channels: dict[str, ChannelTimes] = {}
    gaps: dict[str, list[F64]] = defaultdict(list)
    for (name, _epoch), pairs in heads.items():
        channel = channels.setdefault(name, ChannelTimes(name))
        columns = np.array(pairs, np.int64)  # (n, 2): utime, seq
        steps = np.diff(columns, axis=0)  # (n-1, 2)
        channel.count += len(pairs)
        channel.lost += int(np.maximum(steps[:, 1] - 1, 0).sum())
        # Only true neighbours: a lost message is counted as lost, not as jitter.
        gaps[name].append(steps[steps[:, 1] == 1, 0].astype(np.float64))
    for name, parts in gaps.items():
        channels[name].gaps_us = np.concatenate(parts)
    return channels


def _processes(beats: list[Any], logs: Path, duration_s: float) -> dict[str, ProcessTimes]:
    rows: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    for beat in beats:
        usage = usage_in(beat.detail)
        if usage is not None and beat.state in (heartbeat_t.READY, heartbeat_t.DEGRADED):
            rows[beat.process].append(
                (beat.header.utime * 1e-6, usage.cpu_s, usage.memory_kb * 1.024e-3)
            )
    lines = {path.stem: _count_lines(path) for path in sorted(logs.glob("*.log"))}
    processes = {}
    for name in sorted({*rows, *lines}):
        columns = np.array(rows[name], np.float64).reshape(-1, 3)
        processes[name] = ProcessTimes(
            elapsed_s=columns[:, 0] - (columns[0, 0] if len(columns) else 0.0),
            cpu_s=columns[:, 1],
            memory_mb=columns[:, 2],
            log_lines=lines.get(name, 0),
            duration_s=duration_s,
        )
    return processes


def _count_lines(path: Path) -> int:
    with path.open("rb") as file:
        return sum(1 for _ in file)
