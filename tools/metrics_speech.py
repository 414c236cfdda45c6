"""What speech did in a run: commands obeyed, false triggers, gestures against the sound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from downbeat.lcm_types import (
    skill_request_t,
    skill_status_t,
    speech_intent_t,
    speech_t,
)
from downbeat.tools.runlog import RunLog

OBEYED_WITHIN_S = 8.0
"""From the end of the utterance to the onset: footwork has to find its exit."""
COMMANDS = (
    speech_intent_t.STOP,
    speech_intent_t.SKILL,
    speech_intent_t.AGAIN,
    speech_intent_t.TEMPO,
    speech_intent_t.RESUME,
)


@dataclass(frozen=True)
class SpokenTruth:
    """One utterance of the truth file; times [s of the show].

    Attributes:
        start_s, end_s: When it was spoken.
        text: What.
        expected: Skill, "stop", "resume", "answer" (a question) or "" (nothing may happen).
    """

    start_s: float
    end_s: float
    text: str
    expected: str


def spoken_truth(raw: dict[str, Any]) -> list[SpokenTruth]:
    """Return the utterances of a truth file, in order."""
    return [
        SpokenTruth(
            float(row["start_s"]), float(row["end_s"]), str(row["text"]), str(row["expected"])
        )
        for row in raw.get("speech", [])
    ]


def speech_report(log: RunLog, raw: dict[str, Any], zero_utime: int) -> dict[str, Any] | None:
    """Judge a run's speech; None if nobody spoke in it.

    Args:
        log: The run.
        raw: Content of truth.json.
        zero_utime: When sample 0 sounded [us].
    """
    truth = spoken_truth(raw)
    if not truth:
        return None
    rows = [_judge(log, one, zero_utime, after) for one, after in _with_next(truth)]
    commands = [row for row in rows if row["expected"] not in ("", "answer")]
    others = [row for row in rows if row["expected"] in ("", "answer")]
    latency_ms = [row["latency_ms"] for row in rows if row["latency_ms"] is not None]
    return {
        "commands": len(commands),
        "obeyed": sum(row["good"] for row in commands),
        "others": len(others),
        "false_triggers": sum(bool(row["found"]) for row in others),
        "questions": sum(row["expected"] == "answer" for row in rows),
        "answered": sum(row["good"] for row in rows if row["expected"] == "answer"),
        "request_latency_ms": _percentiles(latency_ms),
        "gestures": _gestures(log),
        "resumed": _resumed(log),
        "utterances": rows,
    }


def _with_next(truth: list[SpokenTruth]) -> list[tuple[SpokenTruth, float]]:
    ends = [one.start_s for one in truth[1:]] + [float("inf")]
    return list(zip(truth, ends, strict=True))


def _judge(log: RunLog, said: SpokenTruth, zero_utime: int, until_s: float) -> dict[str, Any]:
    """Judge one utterance by the intents, answers and skills up to the next one."""
    begin = zero_utime + round(said.start_s * 1e6)
    end = zero_utime + round(said.end_s * 1e6)
    until = zero_utime + round(min(until_s, said.end_s + OBEYED_WITHIN_S) * 1e6)
    intents = [
        msg
        for msg in log.events["SPEECH_INTENT"]
        if begin < msg.end_utime <= max(until, end) and msg.kind in COMMANDS
    ]
    found = [_name(msg) for msg in intents]
    answers = [
        msg
        for msg in log.events["SPEECH"]
        if msg.state == speech_t.STARTED and end < msg.header.utime < until
    ]
    onset_s = None
    if said.expected == "":
        good = not found
    elif said.expected == "answer":
        good = bool(answers) and not found
    else:
        skill = {"stop": "stand", "resume": ""}.get(said.expected, said.expected)
        onset_s = _onset_s(log, skill, end, until)
        good = found[:1] == [said.expected] and (onset_s is not None or not skill)
    latency_ms = [(msg.header.utime - end) / 1e3 for msg in intents]
    return {
        "text": said.text,
        "expected": said.expected,
        "found": " ".join(found),
        "good": good,
        "latency_ms": round(latency_ms[0], 1) if latency_ms else None,
        "onset_s": None if onset_s is None else round(onset_s, 3),
    }


def _name(msg: Any) -> str:
    if msg.kind == speech_intent_t.SKILL:
        return str(msg.skill)
    names = {v: k for k, v in vars(speech_intent_t).items() if k.isupper() and isinstance(v, int)}
    return names[msg.kind].lower()


def _onset_s(log: RunLog, skill: str, end: int, until: int) -> float | None:
    """Return how long after the utterance the skill took over [s]; it may have run already."""
    for msg in log.events["SKILL_STATUS"]:
        if msg.source != skill_request_t.SOURCE_SPEECH or msg.skill != skill:
            continue
        if msg.state == skill_status_t.RUNNING and end - 200_000 < msg.onset_utime <= until:
            return float(msg.onset_utime - end) * 1e-6
    return None


def _gestures(log: RunLog) -> dict[str, Any]:
    """Compare the sound of each answer with the gesture: first and last tick of half weight."""
    control = log.control
    starts, ends, without = [], [], 0
    spans = _spoken_spans(log)
    for begin, end, gesture in spans:
        is_on = control.executed == gesture
        near = (control.utime > begin - 1_500_000) & (control.utime < end + 1_500_000) & is_on
        if not gesture or not near.any():
            without += 1
            continue
        starts.append(abs(int(control.utime[near][0]) - begin) / 1e3)
        ends.append(abs(int(control.utime[near][-1]) + 20_000 - end) / 1e3)
    return {
        "answers": len(spans),
        "without": without,
        "start_skew_ms": _percentiles(starts),
        "end_skew_ms": _percentiles(ends),
        "start_skews_ms": [round(ms, 1) for ms in starts],
        "end_skews_ms": [round(ms, 1) for ms in ends],
    }


def _spoken_spans(log: RunLog) -> list[tuple[int, int, str]]:
    """Return begin, end [us] and gesture of each answer that was spoken to its end."""
    begun: dict[int, Any] = {}
    spans = []
    for msg in log.events["SPEECH"]:
        if msg.state == speech_t.STARTED:
            begun[msg.utterance_id] = msg
        elif msg.state == speech_t.FINISHED and msg.utterance_id in begun:
            first = begun.pop(msg.utterance_id)
            spans.append((int(first.start_utime), int(msg.header.utime), str(first.gesture)))
    return spans


def _resumed(log: RunLog) -> int:
    """Return how often the music's dance took over from what speech had asked for."""
    count, spoken = 0, False
    for msg in log.events["SKILL_STATUS"]:
        if msg.state != skill_status_t.RUNNING:
            continue
        if msg.source == skill_request_t.SOURCE_SPEECH:
            spoken = True
        elif msg.source == skill_request_t.SOURCE_MUSIC and spoken:
            count, spoken = count + 1, False
    return count


def _percentiles(values: list[float]) -> dict[str, float | None]:
    if not values:
        return {"p50": None, "p95": None, "max": None}
    p50, p95 = np.percentile(values, [50, 95])
    return {"p50": round(float(p50), 1), "p95": round(float(p95), 1), "max": round(max(values), 1)}
