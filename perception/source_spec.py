"""Which source a show names: `audio` of show.toml."""

from __future__ import annotations

from pathlib import Path

from downbeat.perception.errors import PerceptionError
from downbeat.perception.source import AUDIO_SUFFIXES, FileSource, Source, load_recording
from downbeat.runtime.bus import Bus

ROBOT, MICROPHONE, CHUNKS = "robot:", "mic:", "chunks:"
VALID = (
    f"a sound file ({', '.join(AUDIO_SUFFIXES)}) of the show's folder, "
    f'"{MICROPHONE}" (the default microphone), "{MICROPHONE}NAME", '
    f'"{ROBOT}INTERFACE" (the robot\'s own microphone, e.g. robot:eth0) or '
    f'"{CHUNKS}" (AUDIO_CHUNK of another process)'
)


def is_live(audio: str) -> bool:
    """Whether it sounds by itself, instead of when the operator says so."""
    return audio.startswith((ROBOT, MICROPHONE, CHUNKS))


def open_source(audio: str, folder: Path, bus: Bus, first_sample_utime: int) -> Source:
    """Open what a show names.

    Args:
        audio: File name, "mic:", "mic:NAME", "robot:INTERFACE" or "chunks:".
        folder: Of the show.
        bus: Endpoint of the process that listens.
        first_sample_utime: When a file begins to sound; what live sources hear before is ignored
            [us].

    Raises:
        PerceptionError: No such form, file, device or interface; the sentence lists those there
            are.
    """
    if audio.startswith(MICROPHONE):
        from downbeat.perception.microphone import Microphone

        return Microphone(bus.clock, audio.removeprefix(MICROPHONE).strip(), first_sample_utime)
    if audio.startswith(ROBOT):
        from downbeat.perception.robot_microphone import RobotMicrophone

        return RobotMicrophone(bus.clock, audio.removeprefix(ROBOT), first_sample_utime)
    if audio == CHUNKS:
        from downbeat.perception.chunk_source import ChunkSource

        return ChunkSource(bus, first_sample_utime)
    path = folder / audio
    if not audio or not path.is_file():
        what = f"there is no file {path}" if audio else "it is empty"
        raise PerceptionError(
            f'audio = "{audio}" cannot be heard: {what}; valid are {VALID}; '
            f"this machine has {microphones()}."
        )
    return FileSource(load_recording(path), first_sample_utime)


def microphones() -> str:
    """Return the microphones of this machine as part of a sentence."""
    from downbeat.perception.sound_devices import device_list, input_devices, load_portaudio

    try:
        return device_list(input_devices(load_portaudio()))
    except PerceptionError:
        return "no PortAudio and so no microphone"
