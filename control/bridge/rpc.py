"""The robot's services (motion switcher, voice): requests out, answers in, nobody waits.

The messages are written and read as bytes: a second of speech would be 32 000 Python integers in
the library's own form.
"""

from __future__ import annotations

import json
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from downbeat.control.bridge.layout import CDR_HEAD, LITTLE_ENDIAN_HEADS

_REQUEST = struct.Struct("<qqqi?3x")
_RESPONSE = struct.Struct("<qqi")
_LENGTH = struct.Struct("<I")
GAP_S = 0.12
"""Between two requests: a service that looks now and then and keeps the last one would lose one."""
MAX_TEXT = 1 << 20
NO_ANSWER = 3104
"""The vendor's code for a request that nobody answered in time."""


class Reader(Protocol):
    """Where answers come from."""

    def take(self) -> list[bytes]:
        """Return what has come since the last take."""
        ...


class Writer(Protocol):
    """Where requests go."""

    def write(self, payload: bytes) -> None:
        """Send one sample."""
        ...


@dataclass(frozen=True, slots=True)
class Answer:
    """What a service said.

    Attributes:
        call: The number that `Service.call` returned.
        api: Which function.
        code: 0 good; 3104 no answer in time; else the service's own.
        data: Its JSON, {} if it sent none that can be read.
    """

    call: int
    api: int
    code: int
    data: dict[str, Any]


def _text(text: str) -> bytes:
    encoded = text.encode() + b"\x00"
    return _LENGTH.pack(len(encoded)) + encoded + bytes(-len(encoded) % 4)


def _binary(data: bytes) -> bytes:
    return _LENGTH.pack(len(data)) + data + bytes(-len(data) % 4)


def encode_request(
    call: int, api: int, parameter: str, data: bytes = b"", noreply: bool = False
) -> bytes:
    """Return a Request_ on the wire."""
    head = _REQUEST.pack(call, api, 0, 0, noreply)
    return CDR_HEAD + head + _text(parameter) + _binary(data)


def encode_response(call: int, api: int, code: int, text: str = "") -> bytes:
    """Return a Response_ on the wire: what a simulated robot answers."""
    return CDR_HEAD + _RESPONSE.pack(call, api, code) + _text(text) + _binary(b"")


def _read_blob(payload: bytes, offset: int) -> tuple[bytes, int]:
    """Return a length-prefixed blob and where the next one begins.

    Raises:
        ValueError: It is cut off.
    """
    if offset + 4 > len(payload):
        raise ValueError("cut off")
    (length,) = _LENGTH.unpack_from(payload, offset)
    end = offset + 4 + length
    if end > len(payload):
        raise ValueError("cut off")
    return payload[offset + 4 : end], end + (-length % 4)


def decode_request(payload: bytes) -> tuple[int, int, str, bytes]:
    """Return (call, api, parameter, binary) of a Request_ on the wire.

    Raises:
        ValueError: It is damaged.
    """
    if payload[0:2] not in LITTLE_ENDIAN_HEADS or len(payload) < 4 + _REQUEST.size:
        raise ValueError("no request")
    call, api, *_rest = _REQUEST.unpack_from(payload, 4)
    text, offset = _read_blob(payload, 4 + _REQUEST.size)
    data, _ = _read_blob(payload, offset)
    return call, api, text.rstrip(b"\x00").decode(errors="replace"), data


def decode_response(payload: bytes) -> Answer:
    """Return what a Response_ on the wire says.

    Raises:
        ValueError: It is damaged.
    """
    if payload[0:2] not in LITTLE_ENDIAN_HEADS or len(payload) < 4 + _RESPONSE.size:
        raise ValueError("no response")
    call, api, code = _RESPONSE.unpack_from(payload, 4)
    text, _ = _read_blob(payload, 4 + _RESPONSE.size)
    try:
        data = json.loads(text.rstrip(b"\x00")[:MAX_TEXT] or b"{}")
    except ValueError:
        data = {}
    return Answer(call, api, code, data if isinstance(data, dict) else {})


class Service:
    """One service of the robot: `call` sends, `poll` returns answers and what got none.

    Requests follow each other at a distance; those that wait go out with `poll`.
    """

    def __init__(
        self,
        requests: Writer,
        responses: Reader,
        timeout_s: float = 1.0,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """Wire it.

        Args:
            requests: Writer of rt/api/NAME/request.
            responses: Reader of rt/api/NAME/response.
            timeout_s: When a call counts as unanswered [s].
            monotonic: Time [s].
        """
        self._requests, self._responses = requests, responses
        self._timeout_s = timeout_s
        self._monotonic = monotonic
        self._waiting: dict[int, tuple[int, float]] = {}
        self._next = int(monotonic() * 1e9)
        self.damaged = 0
        self._outgoing: deque[tuple[int, int, bytes]] = deque()
        self._free_at = 0.0

    def call(self, api: int, parameter: Mapping[str, Any] | None = None, data: bytes = b"") -> int:
        """Send a request; its answer comes from `poll`."""
        self._next += 1
        text = json.dumps(dict(parameter or {}))
        self._outgoing.append((self._next, api, encode_request(self._next, api, text, data)))
        self._send()
        return self._next

    def _send(self) -> None:
        """Send the oldest request unless one was sent just now."""
        now = self._monotonic()
        if self._outgoing and now >= self._free_at:
            call, api, payload = self._outgoing.popleft()
            self._waiting[call] = (api, now + self._timeout_s)
            self._free_at = now + GAP_S
            self._requests.write(payload)

    def poll(self) -> list[Answer]:
        """Return the answers to our own calls; a call without one is answered with 3104."""
        self._send()
        answers = []
        for payload in self._responses.take():
            try:
                answer = decode_response(payload)
            except ValueError:
                self.damaged += 1
                continue
            if self._waiting.pop(answer.call, None) is not None:
                answers.append(answer)
        now = self._monotonic()
        for call, (api, end) in list(self._waiting.items()):
            if now > end:
                del self._waiting[call]
                answers.append(Answer(call, api, NO_ANSWER, {}))
        return answers
