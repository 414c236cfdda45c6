"""What the bridge counts and times while it runs."""

from __future__ import annotations

from dataclasses import dataclass, field

from downbeat.runtime.rate import DurationRecorder


@dataclass(slots=True)
class BridgeTimes:
    """Durations and counts of one run.

    Attributes:
        state_us: From a state's arrival in DDS to the end of its publication on LCM.
        command_us: From a command's arrival on LCM to the end of its write on DDS.
        writes: LowCmd written.
        states: G1_LOW_STATE published.
        superseded: Good states that a newer one overtook before they were published.
    """

    state_us: DurationRecorder = field(default_factory=lambda: DurationRecorder(1 << 16))
    command_us: DurationRecorder = field(default_factory=lambda: DurationRecorder(1 << 16))
    writes: int = 0
    states: int = 0
    superseded: int = 0
