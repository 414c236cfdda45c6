"""`downbeat replay`: re-execute control from a run's journal, or play its log on the bus."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.control.core import TickOutput
from downbeat.control.record import COMPARED, input_of, tick_record
from downbeat.runtime.codec import CodecError
from downbeat.runtime.errors import DownbeatError
from downbeat.runtime.journal import environment, iterate_journal
from downbeat.runtime.log import read_messages
from downbeat.tools.control_journal import JOURNAL_NAME
from downbeat.tools.errors import ToolError
from downbeat.tools.runlog import LOG_NAME
from downbeat.tools.show import SHOW_NAME, load_show, make_core

MAX_HEADER_NOTES = 4


@dataclass(frozen=True, slots=True)
class Difference:
    """The first thing that came out differently.

    Attributes:
        tick: Tick number.
        field: What differs; an element of the command is named by its joint.
        recorded: As the run had it.
        replayed: As it came out now.
    """

    tick: int
    field: str
    recorded: Any
    replayed: Any

    def __str__(self) -> str:
        return f"tick {self.tick}: {self.field} was {self.recorded}, now {self.replayed}"


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a replay found.

    Attributes:
        ticks: Ticks re-executed.
        difference: The first difference; None: bit-identical.
        logged_commands: Commands of the run's log that were compared as well.
        same_machine: The journal comes from this class of CPU and these versions.
        notes: What differs from the machine that recorded it.
    """

    ticks: int
    difference: Difference | None
    logged_commands: int
    same_machine: bool
    notes: tuple[str, ...] = ()

    @property
    def is_equal(self) -> bool:
        """Whether everything came out bit-identical."""
        return self.difference is None


def verify(run_dir: Path) -> Verdict:
    """Re-execute control and compare every tick with the journal, and commands with the log.

    Raises:
        DownbeatError: Journal, show or skills are missing or are not those of the run.
    """
    path = run_dir / JOURNAL_NAME
    records = iterate_journal(path)
    header = next(records, None)
    if header is None or "config" not in header or "policies" not in header["config"]:
        raise ToolError(f"{path} has no header of a control journal.")
    core = make_core(load_show(run_dir / SHOW_NAME))
    _check_policies(header["config"]["policies"], core.library, path)
    logged = _logged_commands(run_dir / LOG_NAME)
    notes = _machine_notes(header)
    ticks = compared = 0
    for record in records:
        try:
            inputs = input_of(record)
        except (CodecError, KeyError, ValueError) as error:
            raise ToolError(f"{path}: tick {record.get('tick')} is no record: {error}.") from error
        output = core.tick(inputs)
        difference = _compare(record, tick_record(inputs, output))
        logged_command = logged.get(inputs.utime)
        if difference is None and logged_command is not None:
            compared += 1
            difference = _compare_command(inputs.tick, logged_command, output)
        elif difference is not None and difference.field == "command" and logged_command:
            difference = _compare_command(inputs.tick, logged_command, output) or difference
        ticks += 1
        if difference is not None:
            return Verdict(ticks, difference, compared, not notes, notes)
    return Verdict(ticks, None, compared, not notes, notes)


def _check_policies(recorded: Mapping[str, str], library: Any, path: Path) -> None:
    for name, digest in recorded.items():
        if name not in library:
            raise ToolError(f"The run had a skill '{name}', which is not here any more ({path}).")
        found = library[name].manifest.sha256
        if found != digest:
            raise ToolError(
                f"Skill '{name}' has SHA-256 {found[:12]}... now and had {digest[:12]}... when the "
                f"run was made; replay needs the same files ({path})."
            )


def _machine_notes(header: Mapping[str, Any]) -> tuple[str, ...]:
    here, notes = environment(), []
    for package, version in header.get("versions", {}).items():
        now = here["versions"].get(package, "")
        if now != version:
            notes.append(f"{package} {version} then, {now} now")
    for key in ("machine", "flags"):
        if header.get("cpu", {}).get(key) != here["cpu"][key]:
            notes.append(f"another CPU ({key})")
    return tuple(notes[:MAX_HEADER_NOTES])


def _logged_commands(path: Path) -> dict[int, Any]:
    if not path.is_file():
        return {}
    return {m.msg.header.utime: m.msg for m in read_messages(path, ("G1_LOW_CMD",))}


def _compare(recorded: Mapping[str, Any], replayed: Mapping[str, Any]) -> Difference | None:
    for name in COMPARED:
        a, b = recorded.get(name), replayed.get(name)
        if a != b and not (a != a and b != b):  # two NaNs are equal here
            return Difference(int(recorded["tick"]), name, a, b)
    return None


def _compare_command(tick: int, logged: Any, output: TickOutput) -> Difference | None:
    from downbeat.catalog.robot import load_g1

    for name in ("joint_pos_target", "joint_stiffness", "joint_damping"):
        a = np.asarray(getattr(logged, name), np.float32)
        b = np.asarray(getattr(output.command, name), np.float32)
        if a.tobytes() != b.tobytes():
            joint = int(np.argmax(a != b))
            field = f"G1_LOW_CMD {name} of {load_g1().joint_names[joint]}"
            return Difference(tick, field, repr(float(a[joint])), repr(float(b[joint])))
    return None


def replay_equal(run_dir: Path) -> bool | None:
    """Return whether a run replays bit-identically; None if it left no journal to replay."""
    if not (run_dir / JOURNAL_NAME).is_file() or not (run_dir / SHOW_NAME).is_file():
        return None
    try:
        return verify(run_dir).is_equal
    except DownbeatError as error:
        print(f"replay: {error}", file=sys.stderr)
        return False


def verify_command(run_dir: Path, as_json: bool) -> int:
    """`downbeat replay RUN --verify`: 0 if bit-identical, 1 if not."""
    started = time.monotonic()
    verdict = verify(run_dir)
    seconds = time.monotonic() - started
    if as_json:
        found = verdict.difference
        print(
            json.dumps(
                {
                    "equal": verdict.is_equal,
                    "ticks": verdict.ticks,
                    "logged_commands": verdict.logged_commands,
                    "same_machine": verdict.same_machine,
                    "notes": verdict.notes,
                    "difference": None
                    if found is None
                    else {
                        "tick": found.tick,
                        "field": found.field,
                        "recorded": str(found.recorded),
                        "replayed": str(found.replayed),
                    },
                }
            )
        )
    else:
        word = "bit-identical" if verdict.is_equal else f"DIFFERENT at {verdict.difference}"
        print(
            f"{verdict.ticks} ticks re-executed in {seconds:.1f} s, {verdict.logged_commands} of "
            f"them held against the log: {word}"
        )
        for note in verdict.notes:
            print(f"note: {note}; another machine may differ in the last bits")
    return 0 if verdict.is_equal else 1


def play_log(run_dir: Path, url: str, speed: float) -> int:
    """Play a run's log on the bus, at its own pace: for lcm-spy and viewers, not for control."""
    import lcm

    from downbeat.runtime.log import read_events
    from downbeat.tools.processes import default_url
    from downbeat.tools.run_realtime import refuse_company

    if speed <= 0.0:
        raise ToolError(f"A speed of {speed} is not possible; it must be above 0 (--speed).")
    target = default_url(url)
    refuse_company(target)
    link = lcm.LCM(target)
    count = 0
    for wait_s, channel, payload in _paced(read_events(run_dir / LOG_NAME), speed):
        if wait_s > 0.0:
            time.sleep(wait_s)
        link.publish(channel, payload)
        count += 1
    print(f"played {count} messages of {run_dir / LOG_NAME} on {target}")
    return 0


def _paced(events: Iterator[Any], speed: float) -> Iterator[tuple[float, str, bytes]]:
    first_utime, start = None, time.monotonic()
    for event in events:
        if first_utime is None:
            first_utime = event.utime
        due = start + (event.utime - first_utime) * 1e-6 / speed
        yield due - time.monotonic(), event.channel, event.payload
