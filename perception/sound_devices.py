"""Sound cards by PortAudio (sounddevice): which microphones there are, and which one is meant."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

from downbeat.perception.errors import PerceptionError

HINT = (
    "install it with `apt-get install libportaudio2` and `pip install 'downbeat[listen]'`, or "
    "hear a file, the robot (robot:INTERFACE) or another process (chunks:)"
)


@dataclass(frozen=True, slots=True)
class InputDevice:
    """A microphone, or whatever else records.

    Attributes:
        number: PortAudio's; changes when devices come and go.
        name: As PortAudio calls it.
        channels: At most.
        sample_rate_hz: Its default [Hz].
    """

    number: int
    name: str
    channels: int
    sample_rate_hz: float


def load_portaudio() -> ModuleType:
    """Import sounddevice.

    Raises:
        PerceptionError: The package or PortAudio itself is missing.
    """
    try:
        import sounddevice
    except (ImportError, OSError) as error:
        raise PerceptionError(f"PortAudio is not usable here ({error}); {HINT}.") from error
    return sounddevice


def input_devices(portaudio: Any) -> list[InputDevice]:
    """Return everything that records; none where PortAudio has nothing to say."""
    try:
        listed = list(portaudio.query_devices())
    except (OSError, ValueError, portaudio.PortAudioError):
        return []
    return [
        InputDevice(
            number,
            str(device["name"]),
            int(device["max_input_channels"]),
            float(device["default_samplerate"]),
        )
        for number, device in enumerate(listed)
        if device["max_input_channels"] > 0
    ]


def find_input(portaudio: Any, wanted: str) -> InputDevice:
    """Return the device that a name means.

    Args:
        portaudio: The module sounddevice.
        wanted: Its name, part of it in any case, or its number; "" for the default one.

    Raises:
        PerceptionError: No such device, several, or none at all.
    """
    devices = input_devices(portaudio)
    if not devices:
        raise PerceptionError(f"No microphone {_quoted(wanted)}: this machine has none at all.")
    if not wanted:
        return _default(portaudio, devices)
    if wanted.isdigit():
        found = [d for d in devices if d.number == int(wanted)]
    else:
        found = [d for d in devices if d.name == wanted]
        found = found or [d for d in devices if wanted.casefold() in d.name.casefold()]
    if len(found) == 1:
        return found[0]
    what = "is not there" if not found else f"may be any of {len(found)}"
    raise PerceptionError(
        f"Microphone {_quoted(wanted)} {what}; this machine has {device_list(devices)}; valid is "
        "a name, a part that only one has, or a number."
    )


def _default(portaudio: Any, devices: list[InputDevice]) -> InputDevice:
    try:
        number = int(portaudio.default.device[0])
    except (TypeError, ValueError, IndexError, AttributeError):
        number = -1
    return next((d for d in devices if d.number == number), devices[0])


def device_list(devices: list[InputDevice]) -> str:
    """Return devices as one line: `0 "USB Audio", 2 "HDA Intel"`."""
    return ", ".join(f'{d.number} "{d.name}"' for d in devices) or "no microphone"


def _quoted(wanted: str) -> str:
    return f'"{wanted}"' if wanted else "(the default one)"
