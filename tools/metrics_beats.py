"""Beats: how far the dance is off the music, in the command and in the body."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from downbeat.policies.manifest import SkillManifest, load_skills
from downbeat.tools.metrics_sections import SectionResult
from downbeat.tools.runlog import RunLog
from downbeat.tools.truth import Segment, TrueBeats, Truth

F64 = NDArray[np.float64]

SETTLE_S = 4.0
"""Of a section, from its onset on, that a phase may take to catch up."""
TEMPO_RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Skill beats per music beat that count as in time."""
LAGS_S = np.arange(-0.10, 0.501, 0.005)
MIN_LAG_TICKS = 100


@dataclass(frozen=True)
class SkillTable:
    """What the evaluator needs of a skill.

    Attributes:
        bpm: Built tempo; 0: no beat.
        duration_s: Length of the loop.
        joint_pos: (N, 29) reference over one loop, or None if there is none.
    """

    bpm: float
    duration_s: float
    joint_pos: F64 | None = None


def reference_at(joint_pos: F64, duration_s: float, phase_s: F64) -> F64:
    """Return a loop's rows (N, 29) at phases (n,) [s], interpolated round the loop, (n, 29)."""
    count = joint_pos.shape[0]
    position = (phase_s / duration_s * count) % count
    index = np.minimum(position.astype(np.int64), count - 1)
    share = (position - index)[:, None]
    return (1.0 - share) * joint_pos[index] + share * joint_pos[(index + 1) % count]


class SkillTables:
    """Tables by skill name, made when they are asked for."""

    def __init__(self, manifests: dict[str, SkillManifest] | None = None) -> None:
        self._manifests = manifests or {}
        self._tables: dict[str, SkillTable] = {}

    @staticmethod
    def bundled() -> SkillTables:
        """Return the tables of the skills in the wheel."""
        return SkillTables(load_skills())

    @staticmethod
    def given(tables: dict[str, SkillTable]) -> SkillTables:
        """Return tables made elsewhere."""
        result = SkillTables()
        result._tables.update(tables)
        return result

    def get(self, name: str) -> SkillTable | None:
        """Return a skill's table, None if it is unknown."""
        if name not in self._tables and name in self._manifests:
            self._tables[name] = _load(self._manifests[name])
        return self._tables.get(name)


def _load(manifest: SkillManifest) -> SkillTable:
    """Read the reference out of the policy: it is one of its outputs."""
    if manifest.bpm <= 0.0:
        return SkillTable(0.0, manifest.duration_s)
    import onnxruntime

    session = onnxruntime.InferenceSession(
        str(manifest.onnx_path), providers=["CPUExecutionProvider"]
    )
    shapes = {i.name: i.shape for i in session.get_inputs()}
    feeds = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    rows = []
    for tick in range(manifest.ticks):
        feeds["time_step"] = np.array([[tick]], np.float32)
        rows.append(session.run(["joint_pos"], feeds)[0][0])
    return SkillTable(manifest.bpm, manifest.duration_s, np.array(rows, np.float64))


@dataclass
class BeatReport:
    """What was found.

    Attributes:
        errors_ms: Absolute error per counted tick.
        section_p95_ms: 95 % point per section index.
        section_lag_ms: Body behind music per section index.
        weights: Ticks behind each lag.
    """

    errors_ms: list[float] = field(default_factory=list)
    section_p95_ms: dict[int, float] = field(default_factory=dict)
    section_lag_ms: dict[int, float] = field(default_factory=dict)
    weights: dict[int, int] = field(default_factory=dict)

    @cached_property
    def physical_lag_ms(self) -> float | None:
        """Mean over sections, weighted by their ticks."""
        if not self.section_lag_ms:
            return None
        lags = [self.section_lag_ms[i] for i in self.section_lag_ms]
        return float(np.average(lags, weights=[self.weights[i] for i in self.section_lag_ms]))


def beat_report(
    log: RunLog,
    truth: Truth,
    zero_utime: int,
    results: list[SectionResult],
    skills: SkillTables,
) -> BeatReport:
    """Compare the dance with the true beats, section by section."""
    report = BeatReport()
    for result in results:
        table = skills.get(result.section.skill)
        if table is None or table.bpm <= 0.0 or result.onset_s is None:
            continue
        for segment in truth.segments:
            beats = truth.beats.get(segment.track)
            chosen = _counted_ticks(log, zero_utime, result, segment)
            if beats is None or not chosen.any():
                continue
            _add_segment(report, log, zero_utime, result, segment, beats, table, chosen)
    return report


def _counted_ticks(
    log: RunLog, zero_utime: int, result: SectionResult, segment: Segment
) -> NDArray[np.bool_]:
    """Return the ticks with the section's skill alone, after it had time to settle, (n,)."""
    control, section = log.control, result.section
    ticks_s = (control.utime - zero_utime) * 1e-6
    onset_s = section.start_s + (result.onset_s or 0.0)
    start_s = max(onset_s + SETTLE_S, segment.start_s)
    end_s = min(section.end_s, segment.end_s)
    alone = (control.skill == section.skill) & (control.previous_skill == "")
    alone &= control.blend_weight >= 1.0 - 1e-6
    return alone & (ticks_s > start_s) & (ticks_s < end_s)


def _add_segment(
    report: BeatReport,
    log: RunLog,
    zero_utime: int,
    result: SectionResult,
    segment: Segment,
    beats: TrueBeats,
    table: SkillTable,
    chosen: NDArray[np.bool_],
) -> None:
    control = log.control
    track_s = (control.utime[chosen] - zero_utime) * 1e-6 - segment.start_s + segment.track_from_s
    phase_s, rate = control.phase_s[chosen], control.phase_rate[chosen]
    error_s = phase_error_s(phase_s, rate, table.bpm, beats, track_s)
    errors_ms = np.abs(error_s) * 1e3
    report.errors_ms.extend(errors_ms.tolist())
    index = result.index
    p95 = float(np.percentile(errors_ms, 95))
    report.section_p95_ms[index] = max(p95, report.section_p95_ms.get(index, 0.0))
    lag_s = body_lag_s(log, control.utime[chosen], phase_s - error_s * rate, rate, table)
    if lag_s is not None:
        report.section_lag_ms[index] = lag_s * 1e3
        report.weights[index] = int(chosen.sum())


def phase_error_s(
    phase_s: F64, phase_rate: F64, skill_bpm: float, beats: TrueBeats, track_s: F64
) -> F64:
    """Return by how much the dance is ahead of the music, (n,) [s], modulo one beat.

    The period is the shorter of one skill beat and one music beat; a dance at half or double the
    music's tempo is in time when its beats fall on the music's, or the music's on its.

    Args:
        phase_s: Skill time per tick, (n,).
        phase_rate: Skill seconds per second, (n,).
        skill_bpm: Tempo the skill was built at.
        beats: The music's true beats.
        track_s: True position in the track per tick, (n,).
    """
    music_bpm = beats.bpm(track_s)
    ratio = float(np.median(phase_rate * skill_bpm / music_bpm))
    ratio = min(TEMPO_RATIOS, key=lambda r: abs(np.log(r / max(ratio, 1e-6))))
    skill_beats = phase_s * skill_bpm / 60.0
    finer = max(ratio, 1.0)  # beats of the faster one, per music beat
    ahead = skill_beats * (finer / ratio) - beats.at(track_s) * finer
    ahead = (ahead + 0.5) % 1.0 - 0.5
    return ahead * 60.0 / (music_bpm * finer)


def body_lag_s(
    log: RunLog, utime: NDArray[np.int64], phase_s: F64, rate: F64, table: SkillTable
) -> float | None:
    """Return how far the true joints are behind the reference at the true music phase [s].

    The lag that maximises the correlation of all joints, refined by a parabola; None if there is
    too little to compare.

    Args:
        log: The run.
        utime: Ticks, (n,).
        phase_s: True music phase in skill time at the ticks, (n,).
        rate: Skill seconds per second, (n,).
        table: The skill.
    """
    if table.joint_pos is None or utime.size < MIN_LAG_TICKS or log.truth.utime.size == 0:
        return None
    found = np.searchsorted(log.truth.utime, utime)
    found = np.minimum(found, log.truth.utime.size - 1)
    same = np.abs(log.truth.utime[found] - utime) < 1_000
    if same.sum() < MIN_LAG_TICKS:
        return None
    joints = log.truth.qpos[found[same], 7:]
    joints = joints - joints.mean(axis=0)
    phase_s, rate = phase_s[same], rate[same]
    scores = np.zeros(LAGS_S.size)
    for k, lag_s in enumerate(LAGS_S):
        reference = reference_at(table.joint_pos, table.duration_s, phase_s - rate * lag_s)
        reference = reference - reference.mean(axis=0)
        norm = np.sqrt((joints**2).sum() * (reference**2).sum())
        scores[k] = (joints * reference).sum() / norm if norm > 0.0 else 0.0
    best = int(np.argmax(scores))
    if not 0 < best < LAGS_S.size - 1 or scores[best] < 0.5:
        return None
    left, middle, right = scores[best - 1 : best + 2]
    shift = 0.5 * (left - right) / (left - 2.0 * middle + right)
    return float(LAGS_S[best] + shift * (LAGS_S[1] - LAGS_S[0]))
