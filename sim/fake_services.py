"""The services of a simulated G1: motion switcher, and a voice that writes down what it hears.

Voice API 1.0: 1001 speak a text, 1003 play PCM, 1004 stop, 1005/1006 get/set volume, 1010 light.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from downbeat.control.bridge.rpc import decode_request, encode_response

NOT_IMPLEMENTED = 3203
INVALID = 100


@dataclass(slots=True)
class VoiceRecord:
    """What the voice was asked to do.

    Attributes:
        pcm: Everything played, 16 kHz mono s16le.
        streams: Stream ids in the order of their first chunk.
        texts: Texts spoken.
        stops: PlayStop calls.
        volume: 0..100.
        lights: Colours (R, G, B) in order.
    """

    pcm: bytearray = field(default_factory=bytearray)
    streams: list[str] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    stops: int = 0
    volume: int = 50
    lights: list[tuple[int, int, int]] = field(default_factory=list)


class FakeMotionSwitcher:
    """Has a motion service that lets go when asked."""

    name = "motion_switcher"

    def __init__(self, active: str = "ai", refusals: int = 1) -> None:
        """Begin.

        Args:
            active: Name of the active service, empty: none.
            refusals: Releases that are accepted but change nothing, as the first often does.
        """
        self.active = active
        self._refusals = refusals

    def answer(self, api: int, _parameter: dict[str, Any], _data: bytes) -> tuple[int, str]:
        """Return (code, JSON)."""
        if api == 1001:
            return 0, json.dumps({"name": self.active, "form": "0"})
        if api == 1003:
            if self._refusals:
                self._refusals -= 1
            else:
                self.active = ""
            return 0, ""
        return NOT_IMPLEMENTED, ""


class FakeVoice:
    """Takes everything that the voice service takes."""

    name = "voice"

    def __init__(self) -> None:
        self.record = VoiceRecord()

    def answer(self, api: int, parameter: dict[str, Any], data: bytes) -> tuple[int, str]:
        """Return (code, JSON)."""
        record = self.record
        if api == 1001:
            record.texts.append(str(parameter["text"]))
        elif api == 1003:
            if len(data) % 2:
                return INVALID, ""
            stream = f"{parameter['app_name']}/{parameter['stream_id']}"
            if stream not in record.streams:
                record.streams.append(stream)
            record.pcm += data
        elif api == 1004:
            record.stops += 1
        elif api == 1005:
            return 0, json.dumps({"volume": record.volume})
        elif api == 1006:
            if not 0 <= int(parameter["volume"]) <= 100:
                return INVALID, ""
            record.volume = int(parameter["volume"])
        elif api == 1010:
            record.lights.append(tuple(int(parameter[key]) for key in "RGB"))  # type: ignore[arg-type]
        else:
            return NOT_IMPLEMENTED, ""
        return 0, ""


class ServiceHost:
    """Answers the requests to one service."""

    def __init__(self, service: Any, requests: Any, responses: Any) -> None:
        self._service, self._requests, self._responses = service, requests, responses

    def serve(self) -> None:
        """Answer what has come."""
        for payload in self._requests.take():
            try:
                call, api, text, data = decode_request(payload)
                parameter = json.loads(text or "{}")
            except ValueError:
                continue
            try:
                code, answer = self._service.answer(api, parameter, data)
            except (KeyError, TypeError, ValueError):
                code, answer = INVALID, ""
            self._responses.write(encode_response(call, api, code, answer))
