"""The speech process: AUDIO_CHUNK in; TRANSCRIPT, SPEECH_INTENT and SPEECH out."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from downbeat.lcm_types import audio_chunk_t, music_match_t
from downbeat.perception.conversation import Context, Conversation, Reply
from downbeat.perception.early_guess import LONGEST_S, Guesses, ends_a_pause
from downbeat.perception.grounding import Grounder, IntentKind
from downbeat.perception.own_voice import OwnVoice
from downbeat.perception.recogniser_openai import wav_bytes
from downbeat.perception.recognisers import Recogniser
from downbeat.perception.reply_table import FOLLOWING, NOT_UNDERSTOOD, SERVICE_FAILED
from downbeat.perception.segments import Segment, Segmenter, refusal
from downbeat.perception.speech_messages import (
    KINDS,
    Understood,
    intent_message,
    transcript_message,
)
from downbeat.perception.speech_mouth import Mouth
from downbeat.perception.speech_work import Done, Worker
from downbeat.perception.tts import Spoken, Voice
from downbeat.policies.manifest_types import SkillManifest
from downbeat.runtime.bus import Bus

PERIOD_US = 20_000
CLASSES_KEPT = 120
SORRY_PERIOD_US = 20_000_000
"""It says at most so often that it did not understand."""


@dataclass(frozen=True, slots=True)
class Ears:
    """What turns sound into wishes."""

    segmenter: Segmenter
    recogniser: Recogniser
    grounder: Grounder
    conversation: Conversation | None
    voice: Voice


@dataclass(frozen=True, slots=True)
class Answer:
    """What to say, and its sound."""

    reply: Reply
    spoken: Spoken


class SpeechNode:
    """Node "speech", 50 Hz."""

    name = "speech"
    period_us = PERIOD_US

    def __init__(
        self,
        bus: Bus,
        ears: Ears,
        mouth: Mouth,
        worker: Worker,
        skills: Mapping[str, SkillManifest],
        language: str = "en",
        answer_unrecognised: bool = False,
        keep: Path | None = None,
        titles: Mapping[str, str] | None = None,
    ) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "speech".
            ears: Segmenter, recogniser, grounding, conversation and voice.
            mouth: Where it speaks.
            worker: Does what takes time.
            skills: What may be asked for, by name.
            language: Of the recogniser.
            answer_unrecognised: Say so when speech was heard and nothing understood.
            keep: Folder for recordings; None: nothing is kept.
            titles: Of tracks, by name.
        """
        self._bus = bus
        self._ears = ears
        self._mouth = mouth
        self._worker = worker
        self._skills = skills
        self._language = language
        self._answer_unrecognised = answer_unrecognised
        self._keep = keep
        self._titles = titles or {}
        self._own = OwnVoice()
        self._guesses: Guesses[Understood] = Guesses()
        self._classes: deque[tuple[int, float, float]] = deque(maxlen=CLASSES_KEPT)
        self._next_id = 1
        self._track = ""
        self._sorry_utime = -SORRY_PERIOD_US
        self.refused: dict[str, int] = {}
        """Why segments went no further, and how often."""
        self.failures: list[str] = []
        """What did not work, each thing once."""
        bus.subscribe("AUDIO_CHUNK", "AUDIO_CLASS", "MUSIC_MATCH", "SKILL_STATUS", "CONTROL_STATUS")

    def step(self, utime: int) -> None:
        """Hear, answer and speak at `utime` [us]."""
        self._bus.pump()
        for received in self._bus.take("AUDIO_CLASS"):
            msg = received.msg
            self._classes.append((int(msg.window_end_utime), msg.p_speech, msg.p_music))
        for received in self._bus.take("MUSIC_MATCH"):
            is_locked = received.msg.lock == music_match_t.LOCKED
            self._track = received.msg.track if is_locked else ""
        for received in self._bus.take("AUDIO_CHUNK"):
            self._hear(received.msg, utime)
        for done in self._worker.done(utime):
            self._finish(done, utime)
        self._act_on_guess(utime)
        for received in self._bus.take("SKILL_STATUS"):
            self._mouth.follow(received.msg)
        begun = self._mouth.update(utime)
        if begun is not None:
            self._own.play(begun.samples, utime)

    # ------------------------------------------------------------------ ears

    def _hear(self, msg: audio_chunk_t, utime: int) -> None:
        samples = np.asarray(msg.samples, np.float32) / 32768.0
        for segment in self._ears.segmenter.push(samples, int(msg.first_sample_utime)):
            why = self._refusal(segment)
            if segment.early:
                self._guess(segment, why, utime)
                continue
            if why:
                self._guesses.drop(segment.serial)
            else:
                why = self._recognise(segment, utime)
            if why:
                self.refused[why.split(" ")[0]] = self.refused.get(why.split(" ")[0], 0) + 1

    def _recognise(self, segment: Segment, utime: int) -> str:
        """Recognise what was said, or take the guess; returns why not."""
        is_guessed, guess = self._guesses.end(segment.serial)
        if guess is not None:
            self._decide(guess, utime)
        if is_guessed or self._worker.submit("hear", lambda: self._understand(segment), utime):
            return ""
        return "too much is waiting"

    def _guess(self, segment: Segment, why: str, utime: int) -> None:
        """Begin to recognise what may go on."""
        if why or self._guesses.running is not None or segment.duration_s > LONGEST_S:
            return
        if self._worker.submit("guess", lambda: self._understand(segment), utime):
            self._guesses.begin(segment.serial)

    def _act_on_guess(self, utime: int) -> None:
        """A command that was heard for sure needs no longer pause."""
        for serial, guess in self._guesses.known():
            is_command = guess.intent.kind in KINDS and guess.intent.kind is not IntentKind.CHAT
            is_sure = is_command and ends_a_pause(guess.recognition)
            if is_sure and self._ears.segmenter.end(serial):
                self._guesses.drop(serial)
                self._decide(guess, utime)

    def _refusal(self, segment: Segment) -> str:
        scores = [
            (speech, music)
            for at, speech, music in self._classes
            if segment.start_utime <= at <= segment.end_utime + 1_000_000
            and math.isfinite(speech)
            and math.isfinite(music)
        ]
        # The windows reach back before the utterance: the one that holds most of it counts.
        best = max(scores, key=lambda pair: pair[0] - pair[1], default=(math.nan, math.nan))
        why = refusal(segment, self._ears.segmenter.config, float(best[0]), float(best[1]))
        if not why and self._own.is_own(segment.samples, segment.start_utime, segment.end_utime):
            why = "own voice"
        return why

    def _understand(self, segment: Segment) -> Understood:
        recognition = self._ears.recogniser.recognise(segment.samples, self._language)
        return Understood(segment, recognition, self._ears.grounder.ground(recognition.text))

    # ------------------------------------------------------------------ decisions

    def _finish(self, done: Done, utime: int) -> None:
        self._note(done.failure)
        if done.name == "guess":
            ended = self._guesses.arrive(done.result)
            if ended is not None:
                self._note(ended.recognition.failure)
                self._decide(ended, utime)
        elif isinstance(done.result, Understood):
            self._note(done.result.recognition.failure)
            self._decide(done.result, utime)
        elif isinstance(done.result, Answer):
            self._note(done.result.reply.failure)
            self._note(done.result.spoken.failure)
            self._mouth.say(done.result.spoken, utime)

    def _note(self, failure: str) -> None:
        """Say on the terminal what does not work, each thing once."""
        if failure and failure not in self.failures:
            self.failures.append(failure)
            print(failure, file=sys.stderr, flush=True)

    def _decide(self, heard: Understood, utime: int) -> None:
        intent, text = heard.intent, heard.recognition.text
        self._bus.publish("TRANSCRIPT", transcript_message(heard, self._language, utime))
        self._store(heard)
        if not text:
            failed = bool(heard.recognition.failure)
            if failed or self._answer_unrecognised:
                self._apologise(SERVICE_FAILED if failed else NOT_UNDERSTOOD, utime)
            return
        if intent.kind not in KINDS:
            return
        if self._mouth.is_speaking and intent.kind is not IntentKind.CHAT:
            self._mouth.stop(utime)  # barge-in: a command ends the answer
            self._own.stop(utime)
        self._bus.publish("SPEECH_INTENT", intent_message(heard, self._next_id, utime))
        self._next_id += 1
        if intent.kind is IntentKind.STOP:
            self._mouth.is_held = True
        elif intent.kind in (IntentKind.SKILL, IntentKind.AGAIN, IntentKind.RESUME):
            self._mouth.is_held = False
        if intent.kind is IntentKind.TEMPO and self._track:
            self._answer(FOLLOWING, utime)
        elif intent.kind is IntentKind.CHAT and self._ears.conversation is not None:
            context, chat = self._context(), self._ears.conversation
            self._speak(lambda: chat.reply(text, context), utime)

    def _apologise(self, text: str, utime: int) -> None:
        """Say that something was not understood, now and then."""
        if utime - self._sorry_utime > SORRY_PERIOD_US:
            self._sorry_utime = utime
            self._answer(text, utime)

    def _answer(self, text: str, utime: int) -> None:
        self._speak(lambda: Reply(text, "own"), utime)

    def _speak(self, think: Callable[[], Reply], utime: int) -> None:
        voice = self._ears.voice

        def work() -> Answer:
            reply = think()
            return Answer(reply, voice.say(reply.text))

        self._worker.submit("answer", work, utime)

    def _context(self) -> Context:
        received = self._bus.latest("CONTROL_STATUS")
        name = "" if received is None else received.msg.skill
        playing = self._skills[name].title if name in self._skills and name != "stand" else ""
        titles = tuple(
            one.title for key, one in self._skills.items() if key not in ("stand", "talk")
        )
        return Context(titles, playing, self._titles.get(self._track, self._track))

    # ------------------------------------------------------------------ the rest

    def _store(self, heard: Understood) -> None:
        if self._keep is None:
            return
        self._keep.mkdir(parents=True, exist_ok=True)
        path = self._keep / f"{heard.segment.start_utime}.wav"
        path.write_bytes(wav_bytes(heard.segment.samples))
        path.with_suffix(".txt").write_text(heard.recognition.text + "\n", encoding="utf-8")

    def close(self) -> None:
        """Finish what sounds."""
        self._worker.close()
        self._mouth.close()
