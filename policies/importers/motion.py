"""Reference motions in files: CSV and NPZ tables of strangers become one table at 50 Hz."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.files import checked_file
from downbeat.runtime.errors import one_of

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Tables = dict[str, F32]
"""joint_pos, joint_vel (T, n) policy order; anchor_pos (T, 3); anchor_quat (T, 4) wxyz."""

RATE_HZ = 50.0
MAX_BYTES = 200_000_000
MAX_ROWS = 100_000
SHORTEST_S = 0.1
WAIST = ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint")
WAIST_AXES = "ZXY"
TORSO_OFFSET_M = (-0.0039635, 0.0, 0.044)
"""Origin of the torso in waist_yaw_link (catalog/g1_facts.json)."""


class Source:
    """A motion as a file has it, at its own rate.

    Attributes:
        path: The file.
        rate_hz: Rows per second.
        columns: Joint of each column.
        joint_pos: (T, columns) [rad].
        joint_vel: (T, columns) [rad/s].
        base_pos: (T, 3) [m] of the pelvis.
        base_quat: (T, 4) xyzw of the pelvis.
    """

    def __init__(
        self, path: Path, rate_hz: float, columns: Sequence[str], base: F64, joint_pos: F64
    ) -> None:
        self.path = path
        self.rate_hz = rate_hz
        self.columns = list(columns)
        self.joint_pos = joint_pos
        self.joint_vel = np.gradient(joint_pos, 1.0 / rate_hz, axis=0)
        self.base_pos = base[:, :3]
        self.base_quat = base[:, 3:7]


def read_csv(path: Path, folder: Path) -> F64:
    """Read a motion file: base position 3, quaternion xyzw 4, joints.

    Raises:
        PolicyError: Missing, too large, not numbers, or no motion.
    """
    checked_file(path, folder, MAX_BYTES)
    try:
        with path.open(encoding="utf-8") as lines:
            table = np.loadtxt(lines, delimiter=",", ndmin=2, max_rows=MAX_ROWS + 1)
    except (OSError, ValueError) as error:
        raise PolicyError(f"{path} is not a table of numbers: {error}.") from error
    _check_rows(path, table)
    return table


def _check_rows(path: Path, *tables: Any) -> None:
    rows = len(tables[0])
    if not 2 <= rows <= MAX_ROWS:
        raise PolicyError(f"{path} has {rows} rows; 2..{MAX_ROWS} are valid.")
    if not all(np.isfinite(table).all() for table in tables):
        raise PolicyError(f"{path} has numbers that are not finite.")


def csv_source(table: F64, path: Path, rate_hz: float, columns: Sequence[str]) -> Source:
    """Return the motion of a CSV table.

    Raises:
        PolicyError: The number of columns is wrong, or a quaternion is none.
    """
    if table.shape[1] != 7 + len(columns):
        raise PolicyError(
            f"{path} has {table.shape[1]} columns; {7 + len(columns)} are expected: base position "
            f"3, quaternion xyzw 4, {len(columns)} joints."
        )
    return Source(path, rate_hz, columns, _checked_base(path, table[:, :7]), table[:, 7:])


def npz_source(path: Path, folder: Path, joint_names: Sequence[str]) -> Source:
    """Read a BeyondMimic motion table: fps, joint_pos, joint_vel, body_pos_w, body_quat_w.

    The joints are the policy's, in its order; body 0 is the pelvis.

    Raises:
        PolicyError: It has not these tables, or they do not fit each other.
    """
    tables = _read_npz(path, folder, ("fps", "joint_pos", "joint_vel", "body_pos_w", "body_quat_w"))
    fps = float(tables["fps"].reshape(-1)[0]) if tables["fps"].size == 1 else 0.0
    rows, count = len(tables["joint_pos"]), len(joint_names)
    shapes = {"joint_pos": (count,), "joint_vel": (count,)}
    for name, inner in shapes.items():
        if tables[name].shape != (rows, *inner):
            raise PolicyError(
                f"{path}: {name} is {tables[name].shape}; ({rows}, {count}) is expected."
            )
    for name, last in (("body_pos_w", 3), ("body_quat_w", 4)):
        table = tables[name]
        if table.ndim != 3 or len(table) != rows or table.shape[1] < 1 or table.shape[2] != last:
            raise PolicyError(
                f"{path}: {name} is {table.shape}; ({rows}, bodies, {last}) is expected."
            )
    if not 1.0 <= fps <= 1000.0:
        raise PolicyError(f"{path}: fps is {fps:g}; 1..1000 is valid.")
    xyzw = np.roll(tables["body_quat_w"][:, 0], -1, axis=1)
    base = np.concatenate([tables["body_pos_w"][:, 0], xyzw], axis=1)
    _check_rows(path, tables["joint_pos"], tables["joint_vel"], base)
    source = Source(path, fps, joint_names, _checked_base(path, base), tables["joint_pos"])
    source.joint_vel = tables["joint_vel"]
    return source


def read_tables(path: Path, folder: Path) -> Tables:
    """Read a table of our own kind.

    Raises:
        PolicyError: It has not these tables.
    """
    names = ("joint_pos", "joint_vel", "anchor_pos", "anchor_quat")
    found = _read_npz(path, folder, names)
    _check_rows(path, *found.values())
    return {name: found[name].astype(np.float32) for name in names}


def _read_npz(path: Path, folder: Path, names: Sequence[str]) -> dict[str, F64]:
    checked_file(path, folder, MAX_BYTES)
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > MAX_BYTES:
            raise PolicyError(f"{path} unpacks to more than {MAX_BYTES} bytes.")
        with np.load(path, allow_pickle=False) as file:
            missing = [name for name in names if name not in file]
            if missing:
                raise PolicyError(
                    f"{path} has no table '{missing[0]}'; it has {one_of(file.files)}."
                )
            return {name: np.asarray(file[name], np.float64) for name in names}
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise PolicyError(f"{path} is not a table of numbers: {error}.") from error


def _checked_base(path: Path, base: F64) -> F64:
    norms = np.linalg.norm(base[:, 3:7], axis=1)
    if (np.abs(norms - 1.0) > 0.05).any():
        row = int(np.argmax(np.abs(norms - 1.0)))
        raise PolicyError(
            f"{path}: row {row} has a quaternion of norm {norms[row]:.2f}; unit quaternions xyzw "
            "are expected after the base position."
        )
    return base


def resample(
    source: Source, start_s: float, end_s: float | None, joint_names: Sequence[str], anchor: str
) -> Tables:
    """Cut a motion and resample it to 50 Hz.

    Args:
        source: The motion.
        start_s: What to keep [s], from here.
        end_s: To here [s]; None: to the end.
        joint_names: Joints of the policy, in its order.
        anchor: "torso_link" or "pelvis".

    Raises:
        PolicyError: Nothing would be left.
    """
    times = np.arange(len(source.joint_pos)) / source.rate_hz
    end = times[-1] if end_s is None else min(end_s, times[-1])
    if not 0.0 <= start_s < end - SHORTEST_S:
        raise PolicyError(
            f"A motion from {start_s:g} s to {end:g} s is empty; {source.path} lasts "
            f"{times[-1]:g} s (motion.start_s, motion.end_s)."
        )
    wanted = np.arange(start_s, end + 1e-9, 1.0 / RATE_HZ)
    pos = _resampled(times, source.joint_pos, wanted)
    order = [source.columns.index(name) for name in joint_names]
    rotation = Slerp(times, Rotation.from_quat(source.base_quat))(np.minimum(wanted, times[-1]))
    place = _resampled(times, source.base_pos, wanted)
    if anchor == "torso_link":
        place, rotation = _torso(place, rotation, pos, source.columns)
    return {
        "joint_pos": pos[:, order].astype(np.float32),
        "joint_vel": _resampled(times, source.joint_vel, wanted)[:, order].astype(np.float32),
        "anchor_pos": place.astype(np.float32),
        "anchor_quat": np.roll(rotation.as_quat(), 1, axis=1).astype(np.float32),  # wxyz
    }


def _torso(place: F64, rotation: Any, pos: F64, columns: list[str]) -> tuple[F64, Any]:
    waist = np.zeros((len(pos), 3))
    for index, name in enumerate(WAIST):
        if name in columns:
            waist[:, index] = pos[:, columns.index(name)]
    yawed = rotation * Rotation.from_euler("Z", waist[:, :1])
    torso = rotation * Rotation.from_euler(WAIST_AXES, waist)
    return place + yawed.apply(np.asarray(TORSO_OFFSET_M)), torso


def _resampled(times: F64, values: F64, wanted: F64) -> F64:
    return np.stack([np.interp(wanted, times, column) for column in values.T], axis=1)


def csv_columns(count: int, joint_names: Sequence[str]) -> tuple[str, ...] | None:
    """Return the joints of a file with `count` joint columns; None if that cannot be said."""
    robot = load_g1().joint_names
    if count == len(robot):
        return robot
    return tuple(joint_names) if count == len(joint_names) else None
