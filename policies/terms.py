"""Names and widths of the observation terms that policies may ask for.

`control/observation.py` computes them; importers translate each dialect's names into these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

TERM_WIDTHS: Mapping[str, Callable[[int], int]] = {
    "projected_gravity": lambda n: 3,
    "base_ang_vel": lambda n: 3,
    "base_lin_vel": lambda n: 3,
    "joint_pos": lambda n: n,
    "joint_pos_rel": lambda n: n,
    "joint_vel": lambda n: n,
    "last_action": lambda n: n,
    "velocity_commands": lambda n: 3,
    "velocity_command_xy": lambda n: 2,
    "velocity_command_yaw": lambda n: 1,
    "motion_command": lambda n: 2 * n,
    "motion_joint_pos": lambda n: n,
    "motion_joint_vel": lambda n: n,
    "motion_anchor_pos_b": lambda n: 3,
    "motion_anchor_ori_b": lambda n: 6,
    "motion_phase": lambda n: 1,
    "gait_phase": lambda n: 2,
    "feet_phase_sin": lambda n: 2,
    "feet_phase_cos": lambda n: 2,
}
"""Term name -> its width, given the number of joints of the policy.

- `joint_pos` is absolute [rad], `joint_pos_rel` relative to the policy's default pose;
  `joint_vel` [rad/s]; all in the policy's own joint order.
- `motion_command` is reference joint_pos and joint_vel side by side (BeyondMimic "command").
- `motion_anchor_ori_b`: the first two columns of the reference anchor's rotation seen from the
  robot's anchor, row by row.
- `gait_phase`: sine and cosine of one phase; `feet_phase_*`: of the left and the right foot's.
- `motion_phase`: 0..1 over the motion.
"""

MOTION_TERMS = frozenset(
    {
        "motion_command",
        "motion_joint_pos",
        "motion_joint_vel",
        "motion_anchor_pos_b",
        "motion_anchor_ori_b",
    }
)
"""Terms that need a reference motion."""
COMMAND_TERMS = frozenset({"velocity_commands", "velocity_command_xy", "velocity_command_yaw"})
"""Terms that make a policy a locomotion policy."""
GAIT_TERMS = frozenset({"gait_phase", "feet_phase_sin", "feet_phase_cos"})
"""Terms that need a gait clock."""
