"""Reference motions: CSV files and motions baked into a network become one table at 50 Hz."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.network import Network

F32 = npt.NDArray[np.float32]
Tables = dict[str, F32]

RATE_HZ = 50.0
MAX_CSV_BYTES = 100_000_000
MAX_ROWS = 100_000
CONSTANT_ROWS = 250
"""A baked motion that shows its last row for this long is over."""
WAIST = ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint")
WAIST_AXES = "ZXY"
TORSO_OFFSET_M = (-0.0039635, 0.0, 0.044)
"""Origin of the torso in waist_yaw_link (catalog/g1_facts.json)."""


def read_csv(path: Path) -> npt.NDArray[np.float64]:
    """Read a motion file: base position 3, quaternion xyzw 4, joints.

    Raises:
        PolicyError: Missing, too large, not numbers, or no motion.
    """
    try:
        if path.stat().st_size > MAX_CSV_BYTES:
            raise PolicyError(f"{path} is larger than {MAX_CSV_BYTES} bytes.")
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise PolicyError(f"{path} is not a table of numbers: {error}.") from error
    if len(table) < 2 or len(table) > MAX_ROWS or not np.isfinite(table).all():
        raise PolicyError(f"{path} has {len(table)} rows or numbers that are not finite.")
    return table


def from_csv(
    path: Path,
    rate_hz: float,
    start_s: float,
    end_s: float | None,
    columns: Sequence[str],
    joint_names: Sequence[str],
) -> Tables:
    """Cut and resample a CSV motion.

    Args:
        path: The file.
        rate_hz: Its rows per second.
        start_s: What to keep [s], from here.
        end_s: To here [s]; None: to the end.
        columns: Joint of each joint column.
        joint_names: Joints of the policy, in its order.

    Raises:
        PolicyError: The file does not fit.
    """
    table = read_csv(path)
    if table.shape[1] != 7 + len(columns):
        raise PolicyError(
            f"{path} has {table.shape[1]} columns; {7 + len(columns)} are expected: base position "
            f"3, quaternion xyzw 4, {len(columns)} joints."
        )
    times = np.arange(len(table)) / rate_hz
    end = times[-1] if end_s is None else min(end_s, times[-1])
    if not 0.0 <= start_s < end - 0.1:
        raise PolicyError(
            f"A motion from {start_s:g} s to {end:g} s is empty; {path} lasts {times[-1]:g} s."
        )
    wanted = np.arange(start_s, end + 1e-9, 1.0 / RATE_HZ)
    pos = table[:, 7:]
    vel = np.gradient(pos, 1.0 / rate_hz, axis=0)
    order = [list(columns).index(name) for name in joint_names]
    base_rotation = Slerp(times, Rotation.from_quat(table[:, 3:7]))(wanted)
    base_pos = _resample(times, table[:, :3], wanted)
    joints = _resample(times, pos, wanted)
    waist = np.zeros((len(wanted), 3))
    for index, name in enumerate(WAIST):
        if name in columns:
            waist[:, index] = joints[:, list(columns).index(name)]
    torso = base_rotation * Rotation.from_euler(WAIST_AXES, waist)
    yawed = base_rotation * Rotation.from_euler("Z", waist[:, :1])
    torso_pos = base_pos + yawed.apply(np.asarray(TORSO_OFFSET_M))
    return {
        "joint_pos": joints[:, order].astype(np.float32),
        "joint_vel": _resample(times, vel, wanted)[:, order].astype(np.float32),
        "anchor_pos": torso_pos.astype(np.float32),
        "anchor_quat": np.roll(torso.as_quat(), 1, axis=1).astype(np.float32),  # wxyz
    }


def _resample(times: Any, values: Any, wanted: Any) -> Any:
    return np.stack([np.interp(wanted, times, column) for column in values.T], axis=1)


def csv_columns(count: int, joint_names: Sequence[str]) -> tuple[str, ...] | None:
    """Return the joints of a file with `count` joint columns; None if that cannot be said."""
    robot = load_g1().joint_names
    if count == len(robot):
        return robot
    return tuple(joint_names) if count == len(joint_names) else None


def from_network(network: Network, anchor: str, body_names: Sequence[str], inputs: Any) -> Tables:
    """Read the motion that is baked into a network, row by row.

    Args:
        network: The file.
        anchor: Body that is tracked.
        body_names: Bodies of its outputs, in order.
        inputs: Feed for everything but `time_step`.

    Raises:
        PolicyError: It has no such outputs, or the motion does not end.
    """
    import onnxruntime as ort

    wanted = ["joint_pos", "joint_vel", "body_pos_w", "body_quat_w"]
    missing = [name for name in wanted if name not in network.outputs]
    if missing:
        raise PolicyError(
            f"{network.path} takes a time_step but has no output '{missing[0]}' with the motion."
        )
    if anchor not in body_names:
        raise PolicyError(
            f"Anchor body '{anchor}' of {network.path} is not among its bodies "
            f"{', '.join(body_names)} (metadata: anchor_body_name)."
        )
    session = ort.InferenceSession(str(network.path), providers=["CPUExecutionProvider"])

    def row(step: float) -> list[F32]:
        feed = {**inputs, "time_step": np.full((1, 1), step, np.float32)}
        return [output[0] for output in session.run(wanted, feed)]

    last = row(1e6)
    rows: list[list[F32]] = []
    constant = 0
    while constant < CONSTANT_ROWS:
        found = row(float(len(rows)))
        rows.append(found)
        same = all(np.array_equal(a, b) for a, b in zip(found, last, strict=True))
        constant = constant + 1 if same else 0
        if len(rows) > MAX_ROWS:
            raise PolicyError(f"The motion in {network.path} does not end in {MAX_ROWS} rows.")
    rows = rows[: len(rows) - constant + 1]
    body = list(body_names).index(anchor)
    quats = np.stack([r[3][body] for r in rows])
    return {
        "joint_pos": np.stack([r[0] for r in rows]).astype(np.float32),
        "joint_vel": np.stack([r[1] for r in rows]).astype(np.float32),
        "anchor_pos": np.stack([r[2][body] for r in rows]).astype(np.float32),
        "anchor_quat": (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
    }
