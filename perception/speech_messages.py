"""TRANSCRIPT and SPEECH_INTENT of an utterance that was understood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from downbeat.lcm_types import speech_intent_t, transcript_t
from downbeat.perception.grounding import Intent, IntentKind
from downbeat.perception.recognisers import Recognition
from downbeat.perception.segments import Segment

KINDS = {
    IntentKind.STOP: speech_intent_t.STOP,
    IntentKind.SKILL: speech_intent_t.SKILL,
    IntentKind.AGAIN: speech_intent_t.AGAIN,
    IntentKind.TEMPO: speech_intent_t.TEMPO,
    IntentKind.RESUME: speech_intent_t.RESUME,
    IntentKind.CHAT: speech_intent_t.CHAT,
}


@dataclass(frozen=True, slots=True)
class Understood:
    """A recognised utterance."""

    segment: Segment
    recognition: Recognition
    intent: Intent


def transcript_message(heard: Understood, language: str, utime: int) -> transcript_t:
    """Return the TRANSCRIPT; it may hold no word."""
    msg: Any = transcript_t()
    msg.header.utime = utime
    msg.start_utime = heard.segment.start_utime
    msg.end_utime = heard.segment.end_utime
    msg.is_final = True
    msg.language = language
    msg.text = heard.recognition.text
    msg.confidence = heard.recognition.confidence
    msg.backend = heard.recognition.backend
    msg.compute_us = min(int(heard.recognition.compute_us), 2**31 - 1)
    return msg


def intent_message(heard: Understood, utterance_id: int, utime: int) -> speech_intent_t:
    """Return the SPEECH_INTENT of an utterance that wants something."""
    intent, said = heard.intent, heard.intent.parameters
    msg: Any = speech_intent_t()
    msg.header.utime = utime
    msg.utterance_id = utterance_id
    msg.end_utime = heard.segment.end_utime
    msg.kind = KINDS[intent.kind]
    msg.skill = intent.skill
    msg.score = float(min(max(intent.score, 0.0), 1.0))
    msg.margin = float(intent.margin)
    msg.negated = intent.negated
    msg.duration_s = said.duration_s or 0.0
    msg.distance_m = said.distance_m or 0.0
    msg.repeat = said.repeat or 0
    msg.tempo = said.tempo
    msg.text = heard.recognition.text
    return msg
