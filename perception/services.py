"""OpenAI-compatible services over HTTP: bounded waits, one retry that may help, keys never shown.

Standard library only: three kinds of request do not need a client library, and here every wait,
also on a server that sends a byte a second, ends at one deadline.
"""

from __future__ import annotations

import http.client
import json
import secrets
import socket
import ssl
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from downbeat.perception.errors import PerceptionError

MAX_ANSWER_BYTES = 16 * 1024 * 1024
RETRY_WAIT_S = 0.3
"""Before the second try; a service that asks for more than the deadline leaves is not retried."""
_PIECE = 65_536


class ServiceError(PerceptionError):
    """A service did not answer as it should.

    Attributes:
        status: HTTP status, 0 where there was none.
    """

    def __init__(self, message: str, status: int = 0) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True, slots=True)
class Service:
    """Where a service is and how long it may take.

    Attributes:
        url: Root with its version, "https://host/v1".
        key: Sent as a bearer token; empty: none is sent. Not shown in any text.
        key_variable: Environment variable that the key came from, for error texts.
        timeout_s: Longest time for one answer, with its retry [s].
        retries: How often a failed request is sent again where that may help.
    """

    url: str
    key: str = field(default="", repr=False)
    key_variable: str = "OPENAI_API_KEY"
    timeout_s: float = 10.0
    retries: int = 1

    def __post_init__(self) -> None:
        """Refuse what is no address.

        Raises:
            PerceptionError: The URL is none, or the time is not positive.
        """
        parts = urlsplit(self.url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise PerceptionError(
                f"url = '{self.url}' is no service; valid is http(s)://HOST[:PORT]/v1."
            )
        if not self.timeout_s > 0.0:
            raise PerceptionError(f"timeout_s = {self.timeout_s} is no time; valid is > 0.")

    def post_json(self, path: str, body: Mapping[str, Any]) -> dict[str, Any]:
        """Post JSON, return the JSON object of the answer.

        Raises:
            ServiceError: No answer in time, an error status, or no JSON object.
        """
        return self._object(path, self._post(path, json.dumps(body).encode(), "application/json"))

    def post_for_bytes(self, path: str, body: Mapping[str, Any]) -> bytes:
        """Post JSON, return the bytes of the answer.

        Raises:
            ServiceError: No answer in time, an error status, or nothing in it.
        """
        answer = self._post(path, json.dumps(body).encode(), "application/json")
        if not answer:
            raise ServiceError(f"{self.url}{path} answered with nothing.")
        return answer

    def post_file(
        self,
        path: str,
        fields: Mapping[str, str],
        name: str,
        content: bytes,
        on_event: Callable[[dict[str, Any]], None] | None = None,
    ) -> dict[str, Any]:
        """Post a form with one file, return the JSON object of the answer.

        Args:
            path: Below the root.
            fields: Of the form.
            name: Of the file.
            content: Of the file.
            on_event: Told each server-sent event while the answer streams; the last one is
                returned then. Services that do not stream send one object.

        Raises:
            ServiceError: No answer in time, an error status, or no JSON object.
        """
        boundary = secrets.token_hex(16)
        parts = [
            f'--{boundary}\r\nContent-Disposition: form-data; name="{key}"\r\n\r\n{value}\r\n'
            for key, value in fields.items()
        ]
        head = (
            f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n'
            "Content-Type: audio/wav\r\n\r\n"
        )
        body = "".join([*parts, head]).encode() + content + f"\r\n--{boundary}--\r\n".encode()
        answer = self._post(path, body, f"multipart/form-data; boundary={boundary}")
        if not answer.lstrip().startswith((b"data:", b"event:")):
            return self._object(path, answer)
        last: dict[str, Any] = {}
        for line in answer.decode("utf-8", "replace").splitlines():
            if not line.startswith("data:") or line[5:].strip() in ("", "[DONE]"):
                continue
            last = self._object(path, line[5:].encode())
            if on_event is not None:
                on_event(last)
        if not last:
            raise ServiceError(f"{self.url}{path} sent a stream without an event.")
        return last

    def _object(self, path: str, answer: bytes) -> dict[str, Any]:
        try:
            found = json.loads(answer)
        except ValueError as error:
            raise ServiceError(f"{self.url}{path} answered with what is no JSON.") from error
        if not isinstance(found, dict):
            raise ServiceError(f"{self.url}{path} answered with no JSON object.")
        return found

    def _post(self, path: str, body: bytes, kind: str) -> bytes:
        deadline = time.monotonic() + self.timeout_s
        for turn in range(self.retries + 1):
            try:
                return self._once(path, body, kind, deadline)
            except ServiceError as error:
                wait_s = getattr(error, "wait_s", RETRY_WAIT_S)
                helps = error.status in (0, 408, 409, 429) or error.status >= 500
                if not helps or turn == self.retries or time.monotonic() + wait_s >= deadline:
                    raise
                time.sleep(wait_s)
        raise AssertionError("unreachable")

    def _once(self, path: str, body: bytes, kind: str, deadline: float) -> bytes:
        parts = urlsplit(self.url)
        where = f"{self.url}{path}"
        left = deadline - time.monotonic()
        link: http.client.HTTPConnection
        if parts.scheme == "https":
            link = http.client.HTTPSConnection(
                parts.hostname or "", parts.port, timeout=left, context=ssl.create_default_context()
            )
        else:
            link = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=left)
        headers = {"Content-Type": kind, "Accept": "*/*", "User-Agent": "downbeat"}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        try:
            link.request("POST", parts.path.rstrip("/") + path, body, headers)
            answer = link.getresponse()
            content = _read(link, answer, deadline)
        except (TimeoutError, socket.timeout) as error:  # noqa: UP041 - old servers, old names
            raise ServiceError(f"{where} did not answer within {self.timeout_s:g} s.") from error
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise ServiceError(f"{where} cannot be reached ({type(error).__name__}).") from error
        finally:
            link.close()
        if answer.status // 100 == 2:
            return content
        failure = ServiceError(_words(where, answer.status, self.key_variable), answer.status)
        if answer.status == 429:
            failure.wait_s = _retry_after(answer)  # type: ignore[attr-defined]
        raise failure


def _read(link: http.client.HTTPConnection, answer: http.client.HTTPResponse, end: float) -> bytes:
    """Read an answer until the deadline, also where it comes byte by byte."""
    content = bytearray()
    while True:
        left = end - time.monotonic()
        if left <= 0.0:
            raise TimeoutError
        if link.sock is not None:
            link.sock.settimeout(left)
        piece = answer.read1(_PIECE)
        if not piece:
            return bytes(content)
        content += piece
        if len(content) > MAX_ANSWER_BYTES:
            raise ValueError("too long")


def _retry_after(answer: http.client.HTTPResponse) -> float:
    try:
        return max(0.0, float(answer.getheader("Retry-After") or RETRY_WAIT_S))
    except ValueError:
        return RETRY_WAIT_S


def _words(where: str, status: int, key_variable: str) -> str:
    if status in (401, 403):
        return f"{where} refuses the key ({status}); set a valid one in {key_variable}."
    if status == 404:
        return f"{where} does not exist (404); check url and model."
    if status == 429:
        return f"{where} has had enough requests (429)."
    return f"{where} answered with status {status}."
