"""What a skill manifest says, as frozen data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from downbeat.policies.spec import PolicySpec

Kind = Literal["planted", "stepping", "locomotion", "tracking"]


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """What a locomotion skill may be asked for, base frame.

    Attributes:
        vx, vy: (low, high) [m/s].
        yaw_rate: (low, high) [rad/s].
        slew_linear: Fastest change of vx and vy [m/s^2].
        slew_yaw: Fastest change of the yaw rate [rad/s^2].
        heading_gain: Yaw rate per heading error [1/s]; holds a straight line.
        heading_filter_s: Time constant of the low pass on the measured heading [s].
    """

    vx: tuple[float, float]
    vy: tuple[float, float]
    yaw_rate: tuple[float, float]
    slew_linear: float
    slew_yaw: float
    heading_gain: float
    heading_filter_s: float = 0.5


@dataclass(frozen=True, slots=True)
class SkillLimits:
    """What safety allows while this skill plays; the defaults suit our own skills.

    Attributes:
        tilt_rad: Of the pelvis from the vertical [rad].
        joint_range_tolerance_rad: Beyond the range of a joint [rad].
        joint_speed_ratio: Of a joint's speed limit.
        torque_ratio: Share of the effort limit that counts as saturated.
        saturated_s: How long a joint may be saturated without a break [s].
        fall_step_margin_m: A fall is called when the capture point is farther outside both soles
            than this [m], negative: outside; None: the value of the skill's kind.
        fall_tilt_ahead_rad: ... or when the tilt 0.2 s ahead is more than this [rad]; None: the
            value of the skill's kind.
    """

    tilt_rad: float = 0.8
    joint_range_tolerance_rad: float = 0.15
    joint_speed_ratio: float = 1.2
    torque_ratio: float = 0.98
    saturated_s: float = 0.5
    fall_step_margin_m: float | None = None
    fall_tilt_ahead_rad: float | None = None


@dataclass(frozen=True, slots=True)
class CertificateCase:
    """One closed-loop test of a certificate; the worst of its runs.

    Attributes:
        name: What was varied.
        seconds: How long a run lasts [s].
        runs, falls: How many runs, and how many of them fell.
        survived_s: Shortest time on the feet [s].
        rmse_rad: Largest RMS joint error against the reference [rad].
        drift_m: Largest way that the feet crept [m]; walking: largest distance off the line.
        note: What else was measured.
    """

    name: str
    seconds: float
    runs: int
    falls: int
    survived_s: float
    rmse_rad: float
    drift_m: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class Certificate:
    """What a skill survived alone, through ONNX Runtime, in simulation.

    Attributes:
        method: How it was tested, one sentence.
        versions: Versions of the physics and of the inference library.
        passed: No fall in any required case.
        pushes_n_s: Largest survived push forward, back, left, right [N s]; reported, not required.
        case: All cases.
        target_jump_p99_rad: 99th percentile over ticks of the largest one-tick change of a joint's
            target [rad]; a switch is measured against it. 0: not measured.
    """

    method: str
    versions: str
    passed: bool
    pushes_n_s: tuple[float, ...]
    case: tuple[CertificateCase, ...]
    target_jump_p99_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class SkillManifest:
    """One skill, as its manifest describes it.

    Attributes:
        name: Skill name, equal to its folder's.
        title: For people.
        file: ONNX file, relative to the folder.
        sha256: Of the ONNX file.
        licence: SPDX name.
        kind: "planted" (feet stay), "stepping", "locomotion", or "tracking": a learned policy that
            follows a motion and balances by itself.
        loop: Whether it repeats; False: it ends after `duration_s`.
        rate_hz: Control rate.
        duration_s: Length of the loop at the built tempo [s], exact.
        ticks: Rows of the table; `time_step = phase_s / duration_s * ticks`.
        bpm: Built tempo; 0 for gestures.
        beats: Beats per loop; 0 for gestures.
        tempo_range_bpm: Tempos danced by advancing the phase; (0, 0) for gestures.
        observation_names: Terms of `obs`, in order.
        phrases: What a person may say to ask for it.
        descriptions: What it looks like; requests are matched with it by meaning, too.
        entry_phases_s: Phases [s] at which it may be entered; None: any.
        exit_phases_s: Phases [s] at which it may be left; None: any.
        command: Limits of the command input; None without one.
        limits: What safety allows while it plays.
        policy: How an imported network is fed; None: a skill of our own format.
        extra_files: Further files of the skill (weights, motion), relative to the folder.
        extra_sha256: Of those.
        source: Where an imported skill came from.
        inferred: Fields that the importer did not find in the policy's own files, each "field =
            value: from where".
        certificate: What it survived; None before `downbeat policy certify`.
        folder: Where the manifest lies.
    """

    name: str
    title: str
    file: str
    sha256: str
    licence: str
    kind: Kind
    loop: bool
    rate_hz: int
    duration_s: float
    ticks: int
    bpm: float
    beats: int
    tempo_range_bpm: tuple[float, float]
    observation_names: tuple[str, ...]
    folder: Path
    phrases: tuple[str, ...] = ()
    descriptions: tuple[str, ...] = ()
    entry_phases_s: tuple[float, ...] | None = None
    exit_phases_s: tuple[float, ...] | None = None
    command: CommandLimits | None = None
    limits: SkillLimits = SkillLimits()
    policy: PolicySpec | None = None
    extra_files: tuple[str, ...] = ()
    extra_sha256: tuple[str, ...] = ()
    source: str = ""
    inferred: tuple[str, ...] = ()
    certificate: Certificate | None = None

    @property
    def onnx_path(self) -> Path:
        """The ONNX file."""
        return self.folder / self.file
