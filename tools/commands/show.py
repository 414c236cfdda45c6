"""`downbeat demo`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Demo:
    """Play the bundled mashup: heard, recognised, danced; ends with the result table."""

    scene: Literal["mashup", "onstage"] = "mashup"
    """mashup: four tracks cut together; onstage: somebody speaks over the music, and is obeyed and
    answered."""
    lockstep: bool = False
    """One process over memq on simulated time: faster than real time and deterministic."""
    announced: bool = False
    """Give the set list to the conductor, so that it knows the cuts ahead."""
    section_seconds: float = 20.0
    """Length of each track's section [s]."""
    seed: int = 0
    """Seed of the plant's noise."""
    video: bool = True
    """Render video.mp4 after the run."""
    runs: Path = Path("runs")
    """Where runs are kept; `latest` points to the newest."""
    url: str = ""
    """LCM URL; empty: LCM's default group with ttl=0, so that a plain lcm-spy sees the show."""
    imported: Path | None = None
    """Folder of imported policies (downbeat policy import) that may be played besides."""
    fallback: str = ""
    """The skill that catches a fall, e.g. an imported velocity policy; empty: our own best."""
    json: bool = False
    """Print metrics as one JSON object on standard output."""

    def run(self) -> int:
        """Run it; 0 if the robot stayed up and followed every section."""
        from downbeat.tools.demo import run_demo

        return run_demo(self)


@dataclass(frozen=True)
class Rehearse:
    """Plan and simulate every change that a show can ask for: green, through stand, or red.

    What speech may ask for, the gesture of its answers and a stop are looked up for whatever may
    dance then.
    """

    show: tyro.conf.Positional[Path]
    """show.toml."""
    rollouts: int = 64
    """Simulated per change, from its very phase (rounded up to 64)."""
    json: bool = False
    """Print the rows as JSON on standard output."""

    def run(self) -> int:
        """Rehearse; 0 if every change is proven, straight or through stand."""
        from downbeat.tools.rehearse import run_rehearse

        return run_rehearse(self.show, self.rollouts, self.json)
