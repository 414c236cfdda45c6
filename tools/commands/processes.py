"""The processes of a show, one subcommand each; `downbeat demo` starts them all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class ProcessArgs:
    """What every process takes."""

    show: Path
    """show.toml of the run."""
    epoch_utime: int = 0
    """Time base of the show [us]; 0: this process's own start."""
    epoch_monotonic_ns: int = 0
    """Monotonic clock at the epoch [ns]."""
    url: str = ""
    """LCM URL; empty: LCM's default group with ttl=0."""


@dataclass(frozen=True)
class Sim(ProcessArgs):
    """Run the plant: MuJoCo behind G1_LOW_STATE and G1_LOW_CMD."""

    def run(self) -> int:
        """Run until told to stop."""
        from downbeat.tools.processes import run_process

        return run_process("sim", self)


@dataclass(frozen=True)
class Listen(ProcessArgs):
    """Run the listener: sound in, AUDIO_CLASS and MUSIC_MATCH out; by itself, it tells them."""

    def run(self) -> int:
        """Run until told to stop."""
        from downbeat.tools.processes import run_process

        return run_process("listener", self)


@dataclass(frozen=True)
class Source:
    """Only hear, for a listener elsewhere whose show says audio = "chunks:" (AUDIO_CHUNK)."""

    audio: tyro.conf.Positional[str]
    """A sound file, "mic:", "mic:NAME" or "robot:INTERFACE"."""
    url: str = ""
    """LCM URL; empty: LCM's default group with ttl=0; another machine needs ttl=1."""

    def run(self) -> int:
        """Run until told to stop, or to the end of the file."""
        from downbeat.tools.hearing import run_source

        return run_source(self.audio, self.url)


@dataclass(frozen=True)
class Conduct(ProcessArgs):
    """Run the conductor: track position in, SKILL_REQUEST out."""

    def run(self) -> int:
        """Run until told to stop."""
        from downbeat.tools.processes import run_process

        return run_process("conductor", self)


@dataclass(frozen=True)
class Speak(ProcessArgs):
    """Run speech: sound in, TRANSCRIPT, SPEECH_INTENT and SPEECH out."""

    def run(self) -> int:
        """Run until told to stop."""
        from downbeat.tools.processes import run_process

        return run_process("speech", self)


@dataclass(frozen=True)
class Control(ProcessArgs):
    """Run control: state and requests in, G1_LOW_CMD at 50 Hz out."""

    def run(self) -> int:
        """Run until told to stop."""
        from downbeat.tools.processes import run_process

        return run_process("control", self)


@dataclass(frozen=True)
class Record(ProcessArgs):
    """Write every logged channel to run.lcmlog."""

    def run(self) -> int:
        """Run until told to stop."""
        from downbeat.tools.processes import run_process

        return run_process("recorder", self)


@dataclass(frozen=True)
class Check(ProcessArgs):
    """Run the checker: TRANSITION_QUERY in, simulated, TRANSITION_VERDICT out, at idle priority."""

    engine: Literal["auto", "native", "mjx", "warp"] = "native"
    """Who simulates; auto: MJX where there is a GPU."""

    def run(self) -> int:
        """Run until told to stop."""
        from downbeat.tools.processes import run_process

        return run_process("checker", self)
