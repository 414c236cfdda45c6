"""Writes a run folder with a log and a truth file of which everything is known."""

import json
from dataclasses import dataclass, field

import lcm
import numpy as np

from downbeat import lcm_types as t
from downbeat.catalog.robot import load_g1
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.codec import codec_for
from downbeat.tools.metrics_beats import SkillTable, SkillTables

T0 = 1_700_000_000_000_000
FIRST_SAMPLE = T0 + 1_000_000
TICK_US = 20_000
LOOP_S = 4.0
SKILL_BPM = 120.0
SKILLS = ("stand", "sway", "disco", "pump", "robot")
TEMPO_BPM = {"neon": 120.0, "drift": 98.0}
JOINT_AMPLITUDE = np.linspace(0.05, 0.3, 29)


def joint_reference(phase_s):
    """A dance: every joint moves once per beat pair, with its own amplitude, (n, 29)."""
    angle = 2 * np.pi * np.asarray(phase_s)[..., None] / LOOP_S
    return JOINT_AMPLITUDE * (np.sin(angle) + 0.3 * np.sin(3 * angle + 0.5))


def skill_tables():
    ticks = np.arange(200) / 200 * LOOP_S
    dance = SkillTable(SKILL_BPM, LOOP_S, joint_reference(ticks))
    tables = dict.fromkeys(SKILLS, dance)
    tables["stand"] = SkillTable(0.0, 1.0)
    return SkillTables.given(tables)


@dataclass
class Script:
    """A show: (start_s, end_s, skill, track, boundary) and what the robot made of it."""

    sections: list = field(
        default_factory=lambda: [
            (0.0, 10.0, "sway", "neon", "start"),
            (10.0, 20.0, "disco", "neon", "announced"),
            (20.0, 30.0, "pump", "drift", "unannounced"),
            (30.0, 40.0, "robot", "drift", "announced"),
        ]
    )
    onsets_s: tuple = (2.0, 10.04, 22.5, 29.98)
    """Time of half weight of each section's skill; None: never."""
    phase_offset_s: float = 0.0
    """Skill phase ahead of the music."""
    body_lag_s: float = 0.1
    fall_s: tuple | None = None
    wrong_windows: int = 0
    truth_until_s: float = 1e9
    faults: tuple = ()
    """(start_s, end_s) of a tripped fault."""
    stall_s: tuple = (1e9, 1e9)
    """(start_s, end_s) in which the plant did not simulate."""
    checks: tuple = ()
    """(asked_s, rollouts or None: no answer, fallen, refused), answered after 0.1 s."""


class Writer:
    def __init__(self, path):
        self.log = lcm.EventLog(str(path), "w", overwrite=True)
        self.seqs = {}

    def write(self, channel, utime, msg):
        msg.header.utime = utime
        msg.header.seq = self.seqs.get(channel, 0)
        self.seqs[channel] = msg.header.seq + 1
        payload = codec_for(CHANNELS[channel].type).encode(msg)
        self.log.write_event(utime, channel, payload)


def music_beats(script, show_s):
    """True beat position and tempo at a time of the show."""
    for start_s, end_s, _, track, _ in script.sections:
        if start_s <= show_s < end_s:
            bpm = TEMPO_BPM[track]
            segment = [s for s in segments(script) if s["track"] == track][0]
            track_s = show_s - segment["start_s"] + segment["track_from_s"]
            return (track_s - 0.25) * bpm / 60.0, bpm
    return 0.0, 120.0


def segments(script):
    found = {}
    for start_s, end_s, _, track, _ in script.sections:
        entry = found.setdefault(
            track, {"track": track, "track_from_s": 7.0, "start_s": start_s, "end_s": end_s}
        )
        entry["end_s"] = end_s
    return list(found.values())


def write_run(folder, script=None):
    """Write run.lcmlog and truth.json into `folder`; returns it."""
    script = script or Script()
    writer = Writer(folder / "run.lcmlog")
    source = t.audio_source_t()
    source.state = t.audio_source_t.STARTED
    source.first_sample_utime = FIRST_SAMPLE
    source.sample_rate_hz, source.duration_s, source.name = 16000, 40.0, "mashup.wav"
    writer.write("AUDIO_SOURCE", T0, source)
    end_s = script.sections[-1][1]
    events = [("SKILL_STATUS", *event) for event in write_statuses(script)]
    events = sorted([*events, *write_checks(script)], key=lambda event: event[1])
    for tick in range(round((end_s + 1.5) / 0.02)):
        utime = T0 + tick * TICK_US
        show_s = (utime - FIRST_SAMPLE) * 1e-6
        write_control(writer, script, tick, utime, show_s)
        if show_s < script.truth_until_s:
            write_truth(writer, script, utime, show_s)
        if tick % 5 == 0 and not script.stall_s[0] <= show_s < script.stall_s[1]:
            write_state(writer, script, utime, show_s)
        if tick % 25 == 0 and 0 <= show_s < end_s:
            write_match(writer, script, utime, show_s)
        while events and events[0][1] <= utime:
            writer.write(*events.pop(0))
    writer.log.close()
    write_truth_file(folder, script)
    return folder


def executed(script, show_s):
    """(skill, seconds since its onset) at a time."""
    skill, since_s = "stand", 100.0
    for section, onset_s in zip(script.sections, script.onsets_s):
        if onset_s is not None and show_s >= onset_s - 1e-9:
            skill, since_s = section[2], show_s - onset_s
    return skill, since_s


def write_control(writer, script, tick, utime, show_s):
    skill, since_s = executed(script, show_s)
    beats, bpm = music_beats(script, show_s)
    msg = t.control_status_t()
    msg.tick, msg.mode = tick, t.control_status_t.SKILL
    msg.skill = skill
    msg.previous_skill = "stand" if since_s < 0.3 else ""
    msg.blend_weight = min(1.0, 0.5 + since_s / 0.6)
    msg.phase_rate = bpm / SKILL_BPM
    phase_s = beats * 60.0 / SKILL_BPM + script.phase_offset_s * msg.phase_rate
    msg.phase_s = phase_s % LOOP_S if skill != "stand" else 0.0
    msg.lateness_us, msg.compute_us = 100 + tick % 10, 400
    msg.missed = 0
    for start_s, stop_s in script.faults:
        if start_s <= show_s < stop_s:
            msg.mode, msg.fault, msg.fault_text = t.control_status_t.DAMPING, 5, "tilted"
    writer.write("CONTROL_STATUS", utime, msg)


def write_truth(writer, script, utime, show_s):
    beats, bpm = music_beats(script, show_s)
    msg = t.sim_truth_t()
    qpos = np.zeros(36)
    qpos[2], qpos[3] = 0.75, 1.0
    qpos[7:] = load_g1().default_joint_pos
    if executed(script, show_s)[0] != "stand":
        phase_s = beats * 60.0 / SKILL_BPM - script.body_lag_s * bpm / SKILL_BPM
        qpos[7:] += joint_reference(np.array([phase_s]))[0]
    if script.fall_s and script.fall_s[0] <= show_s < script.fall_s[1]:
        qpos[2] = 0.2
    msg.qpos, msg.qvel, msg.contact_force = qpos, np.zeros(35), [160.0, 160.0]
    writer.write("SIM_TRUTH", utime, msg)


def write_state(writer, script, utime, show_s):
    lost_s = script.stall_s[1] - script.stall_s[0] if show_s >= script.stall_s[1] else 0.0
    msg = t.g1_low_state_t()
    msg.tick = round((utime - T0) / 2000 - lost_s * 500)
    msg.imu_pelvis.quat[0] = msg.imu_torso.quat[0] = 1.0
    msg.wireless_remote = bytes(40)
    writer.write("G1_LOW_STATE", utime, msg)


def write_match(writer, script, utime, show_s):
    track = next(s[3] for s in script.sections if s[0] <= show_s < s[1])
    msg = t.music_match_t()
    msg.method, msg.accepted = t.music_match_t.FINGERPRINT, True
    msg.lock = t.music_match_t.LOCKED
    index = writer.seqs.get("MUSIC_MATCH", 0)
    msg.track = "wrong" if index < script.wrong_windows else track
    msg.rate, msg.tau_std_s, msg.next_boundary_s = 1.0, float("nan"), float("nan")
    writer.write("MUSIC_MATCH", utime, msg)


def write_statuses(script):
    """SKILL_STATUS events, in time order, as (utime, msg)."""
    events = []
    for number, (section, onset_s) in enumerate(zip(script.sections, script.onsets_s), start=1):
        if onset_s is None:
            continue
        msg = t.skill_status_t()
        msg.request_id, msg.skill, msg.state = number, section[2], t.skill_status_t.RUNNING
        msg.phase_s, msg.plan = 0.0, "blended"
        events.append((FIRST_SAMPLE + round(onset_s * 1e6), msg))
    refused = t.skill_status_t()
    refused.request_id, refused.state, refused.reason = 99, t.skill_status_t.REFUSED, "no."
    refused.phase_s = float("nan")
    return [(T0, refused), *events]


def write_checks(script):
    """TRANSITION_QUERY, TRANSITION_VERDICT and SKILL_STATUS events as (channel, utime, msg)."""
    events = []
    for number, (asked_s, rollouts, fallen, refused) in enumerate(script.checks, start=1):
        utime = FIRST_SAMPLE + round(asked_s * 1e6)
        query = t.transition_query_t()
        query.query_id, query.request_id, query.num_rollouts = number, 100 + number, 32
        query.from_skill, query.to_skill = "sway", "disco"
        query.deadline_utime = utime + 200_000
        query.qpos[3] = 1.0
        events.append(("TRANSITION_QUERY", utime, query))
        if rollouts is None:
            continue
        answer = t.transition_verdict_t()
        answer.query_id, answer.num_rollouts, answer.num_fallen = number, rollouts, fallen
        answer.verdict = answer.SAFE if rollouts else answer.TIMED_OUT
        events.append(("TRANSITION_VERDICT", utime + 100_000, answer))
        if refused:
            status = t.skill_status_t()
            status.request_id, status.skill, status.state = 100 + number, "disco", status.PLANNING
            status.phase_s = float("nan")
            status.reason = f"not fade_0.3: {fallen} of {rollouts} rollouts from here fell"
            events.append(("SKILL_STATUS", utime + 120_000, status))
    return events


def write_truth_file(folder, script):
    sections = [
        dict(zip(("start_s", "end_s", "skill", "track", "boundary"), section))
        for section in script.sections
    ]
    truth = {
        "version": 1,
        "sample_rate_hz": 44100,
        "duration_s": script.sections[-1][1],
        "announced": True,
        "seed": 7,
        "segments": segments(script),
        "sections": sections,
        "beat_grids": {
            name: {"tempo_bpm": bpm, "first_beat_s": 0.25} for name, bpm in TEMPO_BPM.items()
        },
    }
    (folder / "truth.json").write_text(json.dumps(truth))
