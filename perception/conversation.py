"""What the robot answers: an OpenAI-compatible chat, or a small table that never pretends."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

from downbeat.perception.grounding_rules import plain
from downbeat.perception.reply_table import ANSWERS, NOT_UNDERSTOOD, SERVICE_FAILED
from downbeat.perception.services import Service, ServiceError

DEFAULT_MODEL = "gpt-4o-mini"
SYSTEM_PROMPT = (
    "You are a Unitree G1 humanoid robot on a stage. Answer in one or two short spoken sentences, "
    "friendly and honest, in the language of the question. You cannot do anything but what is "
    "listed; if somebody asks for something else, say so. Never promise to move: movements are "
    "decided elsewhere."
)
MAX_REPLY = 400
"""Letters that are spoken at most, about 25 s."""
MEMORY = 6
"""Sentences of both sides that a chat remembers."""


@dataclass(frozen=True, slots=True)
class Context:
    """What the robot knows about itself at this moment.

    Attributes:
        skills: Titles of what it can do.
        playing: Title of what it does now, empty: it stands.
        track: Title of the music that it hears, empty: none that it knows.
    """

    skills: tuple[str, ...] = ()
    playing: str = ""
    track: str = ""

    def sentences(self) -> str:
        """Return it for a system prompt."""
        return (
            f"You can: {', '.join(self.skills) or 'nothing yet'}. "
            f"You are doing now: {self.playing or 'standing'}. "
            f"The music that plays: {self.track or 'none that you know'}."
        )


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer.

    Attributes:
        text: What is said.
        backend: Who answered.
        failure: Why the service could not, empty if it did.
        is_understood: False for "I did not understand".
    """

    text: str
    backend: str
    failure: str = ""
    is_understood: bool = True


class Conversation(Protocol):
    """Text in, answer out. It never raises, and never waits without a bound."""

    name: str

    def reply(self, text: str, context: Context) -> Reply:
        """Answer what was said."""
        ...


class TableConversation:
    """Answers what a stage asks most, and says honestly that it did not understand the rest."""

    name = "table"

    def reply(self, text: str, context: Context) -> Reply:
        """Answer by the first rule that fits."""
        said = plain(text)
        for pattern, answer in ANSWERS:
            if pattern.search(said):
                return Reply(shorten(answer(context)), self.name)
        return Reply(NOT_UNDERSTOOD, self.name, is_understood=False)


class ChatConversation:
    """An OpenAI-compatible chat with a short memory; the table answers when it fails."""

    name = "openai"

    def __init__(
        self, service: Service, model: str = "", system_prompt: str = "", memory: int = MEMORY
    ) -> None:
        """Begin with an empty memory.

        Args:
            service: Where to ask.
            model: As the service names it; empty: `DEFAULT_MODEL`.
            system_prompt: Who the robot is; empty: `SYSTEM_PROMPT`.
            memory: Sentences of both sides to remember.
        """
        self._service = service
        self._model = model or DEFAULT_MODEL
        self._prompt = system_prompt or SYSTEM_PROMPT
        self._memory: deque[dict[str, str]] = deque(maxlen=max(0, memory))
        self._table = TableConversation()

    def reply(self, text: str, context: Context) -> Reply:
        """Ask the service; what it does not answer the table does."""
        system = {"role": "system", "content": f"{self._prompt} {context.sentences()}"}
        asked = {"role": "user", "content": text[:2_000]}
        body = {
            "model": self._model,
            "messages": [system, *self._memory, asked],
            "max_tokens": 120,
        }
        try:
            answer = self._service.post_json("/chat/completions", body)
            content = answer["choices"][0]["message"]["content"]
            if not isinstance(content, str) or not content.strip():
                raise TypeError
        except ServiceError as error:
            return self._failed(text, context, str(error))
        except (KeyError, IndexError, TypeError):
            return self._failed(text, context, f"{self._service.url} sent no answer to a chat.")
        reply = Reply(shorten(content), self.name)
        self._memory += [asked, {"role": "assistant", "content": reply.text}]
        return reply

    def _failed(self, text: str, context: Context, why: str) -> Reply:
        known = self._table.reply(text, context)
        said = known.text if known.is_understood else SERVICE_FAILED
        return Reply(said, self._table.name, why, known.is_understood)


def shorten(text: str, letters: int = MAX_REPLY) -> str:
    """Return whole sentences of at most so many letters, without what cannot be spoken."""
    spoken = " ".join("".join(c for c in text if c.isprintable() or c.isspace()).split())
    spoken = spoken.replace("*", "").replace("#", "").replace("`", "")
    if len(spoken) <= letters:
        return spoken
    head = spoken[:letters]
    end = max(head.rfind(mark) for mark in ".!?")
    return head[: end + 1] if end > letters // 4 else head.rsplit(" ", 1)[0] + "."
