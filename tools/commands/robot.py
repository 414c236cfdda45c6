"""The robot's side: `downbeat bridge`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Bridge:
    """Drive a real G1 (or a DDS simulator of one): LCM on one side, its DDS on the other."""

    interface: str
    """Network interface to the robot, e.g. eth0; lo for a simulator on this machine."""
    domain: int = 0
    """DDS domain; the robot's own is 0."""
    url: str = ""
    """LCM URL; empty: LCM's default group with ttl=0."""
    settings: Path | None = None
    """TOML file with buttons and limits (docs/robot.md); omitted: the defaults."""
    auto: bool = False
    """Confirm every step by itself; on lo only."""
    compat: bool = False
    """Also speak the channels of walk-these-ways style controllers."""
    lights: bool = True
    """Show on the robot's LED whether it listens, speaks or dances."""
    patience_s: float = 120.0
    """Give up (exit 1) when the robot cannot be taken over within this time; 0: never."""
    epoch_utime: int = 0
    """Time base of the show [us]; 0: this process's own start."""
    epoch_monotonic_ns: int = 0
    """Monotonic clock at the epoch [ns]."""

    def run(self) -> int:
        """Run until told to stop; the robot is left in damping."""
        from downbeat.runtime.clock import TimeBase
        from downbeat.tools.bridge_run import BridgeOptions, bridge

        base = TimeBase(self.epoch_utime, self.epoch_monotonic_ns) if self.epoch_utime else None
        return bridge(
            BridgeOptions(
                interface=self.interface,
                domain=self.domain,
                url=self.url,
                settings=self.settings,
                auto=self.auto,
                compat=self.compat,
                lights=self.lights,
                patience_s=self.patience_s,
                base=base,
            )
        )
