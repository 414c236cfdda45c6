"""Builds the speech process from speech.toml: one place that knows every part."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from downbeat.lcm_types.channels import CHANNELS
from downbeat.perception.errors import PerceptionError
from downbeat.perception.grounding import NOT_BY_VOICE, STAND, Grounder
from downbeat.perception.intent_model import IntentModel
from downbeat.perception.recognisers import make_recogniser
from downbeat.perception.reply_table import QUESTIONS
from downbeat.perception.segments import SegmentConfig, Segmenter
from downbeat.perception.sentence_model import SentenceModel
from downbeat.perception.speaker import FileSpeaker, LocalSpeaker, Speaker
from downbeat.perception.speech_config import SpeechConfig, make_conversation, make_voice
from downbeat.perception.speech_mouth import Mouth
from downbeat.perception.speech_node import Ears, SpeechNode
from downbeat.perception.speech_work import SimulatedWorker, ThreadWorker
from downbeat.perception.tts import SilentVoice
from downbeat.perception.vad import Vad
from downbeat.policies.manifest_types import SkillManifest
from downbeat.runtime.bus import Bus

SPOKEN_NAME = "spoken.wav"
ROBOT = "robot:"
OUTPUTS = "file, card, none or robot:INTERFACE"
EARLY_S = 0.09
"""Pause after which the embedded recogniser begins: three frames of voice activity."""
RESUME_PHRASES = ("keep dancing", "continue", "dance again", "dance to the music")
TEMPO_PHRASES = {
    "faster": "faster",
    "slower": "slower",
    "do it again": "again",
    "once more": "again",
}
"""Phrase -> what it asks for."""


def make_ears(config: SpeechConfig, skills: Mapping[str, SkillManifest]) -> Ears:
    """Load the models: 3 s.

    Raises:
        PerceptionError: Something that the configuration asks for is missing.
    """
    allowed = allowed_skills(config, skills)
    said = sayable(allowed)
    return Ears(
        Segmenter(Vad(), segments_of(config)),
        make_recogniser(config.recogniser, said, os.environ),
        make_grounder(config, allowed),
        make_conversation(config.chat, os.environ),
        make_voice(config.voice, os.environ),
    )


def allowed_skills(
    config: SpeechConfig, skills: Mapping[str, SkillManifest]
) -> dict[str, SkillManifest]:
    """Return what speech may ask for, and stand, which "stop" asks for."""
    return {
        name: one
        for name, one in skills.items()
        if not config.skills or name in config.skills or name == STAND
    }


def introduction(config: SpeechConfig, ears: Ears, skills: Mapping[str, SkillManifest]) -> str:
    """Return in one line what the process hears, understands and does, and on which channels."""
    count = len(set(allowed_skills(config, skills)) - NOT_BY_VOICE - {STAND})
    heard = f"hears AUDIO_CHUNK of {' or '.join(CHANNELS['AUDIO_CHUNK'].publishers)}"
    asks = f"asks for {count} skill{'' if count == 1 else 's'} or a stop on SPEECH_INTENT"
    answers = "answers nothing"
    if ears.conversation is not None:
        places = {"file": f"into {SPOKEN_NAME}", "card": "on the sound card", "none": "in silence"}
        voice = config.voice
        place = places.get(voice.output, f"on {voice.output}")
        how = "as text" if isinstance(ears.voice, SilentVoice) else f"by {ears.voice.name} {place}"
        gesture = f", with '{voice.gesture}'" if voice.gesture else ""
        answers = f"answers from the {ears.conversation.name} on SPEECH {how}{gesture}"
    keeps = f"; keeps what it hears in {config.keep_recordings}" if config.keep_recordings else ""
    language = config.language or "any language"
    return f"speech {heard} by {ears.recogniser.name} ({language}), {asks}, {answers}{keeps}"


def sayable(skills: Mapping[str, SkillManifest]) -> dict[str, str]:
    """Return what the embedded recogniser listens for: phrase -> what it asks for."""
    found = {
        text: name
        for name, one in skills.items()
        if name not in NOT_BY_VOICE
        for text in one.phrases
    }
    found |= dict.fromkeys(QUESTIONS, "")  # answered, nothing more
    found |= dict.fromkeys(RESUME_PHRASES, "resume")
    return found | TEMPO_PHRASES


def segments_of(config: SpeechConfig) -> SegmentConfig:
    """Return when segments end: only the embedded recogniser's guesses cost nothing but time."""
    if config.recogniser.backend != "pocketsphinx" or config.segments.early_s:
        return config.segments
    return replace(config.segments, early_s=EARLY_S)


def make_grounder(config: SpeechConfig, skills: Mapping[str, SkillManifest]) -> Grounder:
    """Return what understands sentences about these skills.

    The embedded model knows the bundled skills; another sentence model, or none, and skills of
    somebody else are understood by likeness.

    Raises:
        PerceptionError: The sentence model that the configuration names cannot be had, or a free
            recogniser was asked for and there is none at all.
    """
    if config.sentence_model:
        return Grounder(skills, SentenceModel(hub_folder(config.sentence_model), None))
    try:
        intents = IntentModel()
        is_all_learned = set(skills) <= {*intents.classes, *NOT_BY_VOICE, STAND}
        return Grounder(skills, intents if is_all_learned else SentenceModel(), intents=intents)
    except PerceptionError:
        if config.recogniser.backend == "pocketsphinx":
            return Grounder(skills, None)  # it only hears known phrases anyway
        raise


def hub_folder(name: str) -> Path:
    """Return the folder of a model: itself, or a copy of what the hub has under that id.

    Raises:
        PerceptionError: It is no folder, and the hub has none, or is out of reach.
    """
    if Path(name).is_dir():
        return Path(name)
    try:
        from huggingface_hub import snapshot_download

        return Path(snapshot_download(name, allow_patterns=["*.json", "model.safetensors"]))
    except Exception as error:  # whatever the hub, the network or the disk do
        raise PerceptionError(
            f"The sentence model '{name}' cannot be had ({type(error).__name__}: "
            f"{str(error)[:120]}); give a folder, or an id of the hub where there is network "
            "(speech.toml: sentence_model)."
        ) from error


def make_speaker(output: str, folder: Path, first_utime: int) -> Speaker | None:
    """Return where it sounds.

    Raises:
        PerceptionError: There is no such output, or no such device.
    """
    if output == "none":
        return None
    if output == "file":
        return FileSpeaker(folder / SPOKEN_NAME, first_utime)
    if output == "card":
        return LocalSpeaker()
    if output.startswith(ROBOT):
        from downbeat.control.bridge.loop import open_service
        from downbeat.control.bridge.voice import SERVICE, RobotSpeaker
        from downbeat.tools.bridge_run import open_link

        return RobotSpeaker(open_service(open_link(output.removeprefix(ROBOT), 0), SERVICE))
    raise PerceptionError(f"voice.output = '{output}' does not exist; valid are {OUTPUTS}.")


def build_speech(
    config: SpeechConfig,
    skills: Mapping[str, SkillManifest],
    bus: Bus,
    folder: Path,
    first_utime: int,
    is_simulated_time: bool,
    titles: Mapping[str, str],
    say: Callable[[str], None] | None = None,
) -> SpeechNode:
    """Build the process; see `show.make_speech`."""
    speaker = make_speaker(config.voice.output, folder, first_utime)
    ears = make_ears(config, skills)
    if say is not None:
        say(introduction(config, ears, skills))
    return SpeechNode(
        bus,
        ears,
        Mouth(bus, speaker, config.voice.gesture),
        SimulatedWorker() if is_simulated_time else ThreadWorker(),
        skills,
        config.language,
        config.answer_unrecognised,
        folder / config.keep_recordings if config.keep_recordings else None,
        titles,
    )
