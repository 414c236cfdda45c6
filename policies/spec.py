"""How a policy network is fed and read: the `[policy]` table of a manifest.

One description for every public format. Importers write it once, control and the batch engines
read it; nothing is guessed at run time. Joint arrays are in the policy's own order (`joint_names`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from downbeat.policies.terms import COMMAND_TERMS, GAIT_TERMS, MOTION_TERMS, TERM_WIDTHS

HistoryOrder = Literal["oldest_first", "newest_first"]
HistoryFill = Literal["first", "zero"]
HistoryLayout = Literal["term", "frame"]
TimeStepMode = Literal["integer", "continuous"]
StillGait = Literal["run", "together"]


@dataclass(frozen=True, slots=True)
class TermSpec:
    """One term of an observation.

    Attributes:
        name: One of `TERM_WIDTHS`.
        scale: Factor, one number or one per element.
        clip: (low, high) before scaling; None: no clip.
        history: Frames of it that the network sees, at least 1.
        past: The frames end with the previous tick; False: with this one.
    """

    name: str
    scale: tuple[float, ...] = (1.0,)
    clip: tuple[float, float] | None = None
    history: int = 1
    past: bool = False

    def width(self, num_joints: int) -> int:
        """Return the width of one frame."""
        return TERM_WIDTHS[self.name](num_joints)


@dataclass(frozen=True, slots=True)
class InputSpec:
    """One input of the network that carries observations.

    Attributes:
        name: Input name in the ONNX file.
        terms: In order.
        history_order: Order of the frames of a history.
        history_fill: What stands in a history at the start: the first sample, or zeros.
        history_layout: "term": all frames of a term, then the next term; "frame": all terms of a
            frame, then the next frame (all terms then have the same history).
        clip: Bound on the finished observation, |x| <= clip; None: none.
    """

    name: str
    terms: tuple[TermSpec, ...]
    history_order: HistoryOrder = "oldest_first"
    history_fill: HistoryFill = "first"
    history_layout: HistoryLayout = "term"
    clip: float | None = None

    def width(self, num_joints: int) -> int:
        """Return the width of the input."""
        return sum(term.width(num_joints) * term.history for term in self.terms)


@dataclass(frozen=True, slots=True)
class RecurrentSpec:
    """One recurrent state: the output of a tick is the input of the next, zeros at the start."""

    input: str
    output: str
    shape: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class MotionSpec:
    """The reference motion of a tracking policy.

    Attributes:
        file: `.npz` beside the manifest: joint_pos, joint_vel (T, n) policy order, anchor_pos
            (T, 3), anchor_quat (T, 4) wxyz, world of the motion; float32.
        rows: T.
        rate_hz: Rows per second.
        anchor_body: The body whose pose is tracked.
    """

    file: str
    rows: int
    rate_hz: float
    anchor_body: str


@dataclass(frozen=True, slots=True)
class GaitSpec:
    """The clock of a policy that is told its gait phase.

    Attributes:
        period_s: Of one gait cycle [s].
        start: Phase at the first tick, 0..1.
        right_offset: Of the right foot against the left, 0..1.
        still: "run": the clock always runs; "together": at zero command both feet have phase 0.5
            and the gait starts anew when it is asked to move.
    """

    period_s: float
    start: float = 0.0
    right_offset: float = 0.5
    still: StillGait = "run"


@dataclass(frozen=True, slots=True)
class HeldJoints:
    """Joints that the network does not move; they are held where they belong.

    Attributes:
        joint_names: Names.
        joint_pos: [rad].
        joint_stiffness: [N m/rad].
        joint_damping: [N m s/rad].
    """

    joint_names: tuple[str, ...] = ()
    joint_pos: tuple[float, ...] = ()
    joint_stiffness: tuple[float, ...] = ()
    joint_damping: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class PolicySpec:
    """Everything that is needed to run a network.

    Attributes:
        dialect: Format it was published in.
        inputs: Inputs that carry observations.
        action_output: Output with the actions, (1, n).
        joint_names: The n joints that it moves, in its order.
        default_joint_pos: (n,) [rad] zero of `joint_pos_rel`.
        action_scale: (n,) [rad] per unit of action.
        action_offset: (n,) [rad]; target = offset + scale * action.
        action_clip: (low, high) of the raw action; None: none.
        joint_stiffness: (n,) [N m/rad].
        joint_damping: (n,) [N m s/rad].
        held: The other joints.
        time_step_input: Input that takes the row of the motion; empty: none.
        time_step_mode: "integer": a baked motion is read at whole rows; "continuous": anywhere.
        recurrent: Recurrent states.
        motion: Reference motion; None without one.
        gait: Gait clock; None without one.
        phase_duration_s: Length of a motion that the network knows by heart and only needs the
            phase of [s]; 0: it has a reference motion, or none at all.
    """

    dialect: str
    inputs: tuple[InputSpec, ...]
    action_output: str
    joint_names: tuple[str, ...]
    default_joint_pos: tuple[float, ...]
    action_scale: tuple[float, ...]
    action_offset: tuple[float, ...]
    joint_stiffness: tuple[float, ...]
    joint_damping: tuple[float, ...]
    action_clip: tuple[float, float] | None = None
    held: HeldJoints = HeldJoints()
    time_step_input: str = ""
    time_step_mode: TimeStepMode = "integer"
    recurrent: tuple[RecurrentSpec, ...] = ()
    motion: MotionSpec | None = None
    gait: GaitSpec | None = None
    phase_duration_s: float = 0.0

    @property
    def num_joints(self) -> int:
        """How many joints it moves."""
        return len(self.joint_names)

    @property
    def term_names(self) -> frozenset[str]:
        """Names of all terms of all inputs."""
        return frozenset(term.name for one in self.inputs for term in one.terms)

    @property
    def takes_command(self) -> bool:
        """Whether it follows a velocity command."""
        return bool(self.term_names & COMMAND_TERMS)

    @property
    def needs_motion(self) -> bool:
        """Whether a term reads the reference motion."""
        return bool(self.term_names & MOTION_TERMS)

    @property
    def needs_gait(self) -> bool:
        """Whether a term reads the gait clock."""
        return bool(self.term_names & GAIT_TERMS)

    @property
    def needs_position(self) -> bool:
        """Whether it reads the robot's estimated place or speed, which hardware cannot measure."""
        return bool(self.term_names & {"motion_anchor_pos_b", "base_lin_vel"})
