"""A stand-in for an OpenAI-compatible service: real HTTP, and misbehaviour on demand."""

from __future__ import annotations

import contextlib
import io
import json
import threading
import time
from collections import deque
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import soundfile


def wav(seconds=0.5, rate=24_000):
    file = io.BytesIO()
    tone = 0.3 * np.sin(2 * np.pi * 220 * np.arange(round(seconds * rate)) / rate)
    soundfile.write(file, tone, rate, format="WAV", subtype="PCM_16")
    return file.getvalue()


class StandIn:
    """`script` says what happens to the next requests; afterwards all is well.

    Words: "ok", "401", "404", "429", "500", "slow" (no answer for a minute), "drip" (a byte every
    0.2 s), "hangup", "garbage", "list", "empty", "stream", "no_choices", "huge".
    """

    def __init__(self, text="do the wave", delay_s=0.0):
        self.script = deque()
        self.text = text
        self.delay_s = delay_s
        self.seen = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *args):
                pass

            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.seen.append((self.path, dict(self.headers), body))
                with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                    outer.answer(self, outer.script.popleft() if outer.script else "ok")

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_port}/v1"
        self.closing = threading.Event()
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def answer(self, handler, how):
        time.sleep(self.delay_s)
        if how.isdigit():
            more = {"Retry-After": "0.1"} if how == "429" else {}
            self.send(handler, b'{"error": {"message": "no"}}', int(how), headers=more)
        elif how == "slow":
            self.closing.wait(60.0)
        elif how == "hangup":
            handler.connection.close()
            handler.close_connection = True
        elif how == "drip":
            handler.send_response(200)
            handler.send_header("Content-Length", "100000")
            handler.end_headers()
            while not self.closing.wait(0.2):
                handler.wfile.write(b" ")
                handler.wfile.flush()
        elif how in ("garbage", "list", "empty", "no_choices"):
            texts = {"garbage": b"{nonsense", "list": b"[1, 2]", "empty": b"", "no_choices": b"{}"}
            self.send(handler, texts[how])
        elif how == "huge":
            self.send(handler, b" " * (17 * 1024 * 1024))
        elif how == "stream":
            events = [{"type": "transcript.text.delta", "delta": "do the "}]
            events.append({"type": "transcript.text.done", "text": self.text})
            lines = "".join(f"data: {json.dumps(event)}\n\n" for event in events)
            self.send(handler, (lines + "data: [DONE]\n\n").encode(), kind="text/event-stream")
        elif handler.path.endswith("/audio/transcriptions"):
            self.send(handler, json.dumps({"text": self.text}).encode())
        elif handler.path.endswith("/audio/speech"):
            self.send(handler, wav(), kind="audio/wav")
        else:
            message = {"role": "assistant", "content": self.text}
            self.send(handler, json.dumps({"choices": [{"message": message}]}).encode())

    @staticmethod
    def send(handler, body, status=200, kind="application/json", headers=None):
        handler.send_response(status)
        handler.send_header("Content-Type", kind)
        handler.send_header("Content-Length", str(len(body)))
        for key, value in (headers or {}).items():
            handler.send_header(key, value)
        handler.end_headers()
        handler.wfile.write(body)

    def close(self):
        self.closing.set()
        self.server.shutdown()
        self.server.server_close()


@contextlib.contextmanager
def stand_in(**options):
    server = StandIn(**options)
    try:
        yield server
    finally:
        server.close()
