"""The embedded answers: what people on a stage ask a robot, and what is true to say."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from downbeat.perception.conversation import Context

NOT_UNDERSTOOD = "Sorry, I did not understand that."
SERVICE_FAILED = "Sorry, I cannot reach my language service right now."
FOLLOWING = "I follow the tempo of the music."

QUESTIONS = (
    "who are you",
    "what is your name",
    "what are you",
    "what can you do",
    "what dances do you know",
    "what song is this",
    "what music is this",
    "what are you dancing",
    "what are you doing",
    "how are you",
    "how do you work",
    "can you hear me",
    "thank you",
    "thanks a lot",
    "good morning",
    "good evening",
    "good night",
    "well done",
    "where are you from",
    "who built you",
    "how old are you",
    "are you a robot",
    "do you like music",
)
"""What the embedded recogniser listens for besides commands."""


def _skills(context: Context) -> str:
    few = [title.lower() for title in context.skills[:5]]
    if not few:
        return "I can stand and listen."
    more = len(context.skills) - len(few)
    rest = f", and {more} more" if more > 0 else ""
    return f"I can dance to music that I know, and do the {', the '.join(few)}{rest}."


def _song(context: Context) -> str:
    return f"This is {context.track}." if context.track else "I do not know this music."


def _doing(context: Context) -> str:
    if context.playing and context.track:
        return f"I am doing the {context.playing.lower()} to {context.track}."
    if context.playing:
        return f"I am doing the {context.playing.lower()}."
    return "I am standing and listening."


def _always(text: str) -> Callable[[Context], str]:
    return lambda _context: text


ANSWERS: tuple[tuple[re.Pattern[str], Callable[[Context], str]], ...] = tuple(
    (re.compile(pattern), answer)
    for pattern, answer in (
        (
            r"\bwhat(?:'s| is)? (?:song|music|track|title)|\bwhat(?:'s| is) (?:this|that|the) "
            r"(?:song|music|track|title|playing)|\bname of (?:this|the|that) (?:song|music|track)"
            r"|\bwhat (?:is|are we) (?:playing|hearing|listening)",
            _song,
        ),
        (
            r"\bwhat (?:can|could) you (?:do|dance)|\bwhat (?:dances|moves|skills|tricks)"
            r"|\bwhich dances|\bhow many dances|\byour (?:skills|abilities)|\bwhat do you know",
            _skills,
        ),
        (r"\bwhat are you (?:doing|dancing)|\bwhat(?: dance)? is (?:this|that) dance", _doing),
        (
            r"\bwho are you|\bwhat are you\b|\bwhat(?:'s| is) your name|\bintroduce yourself"
            r"|\bare you (?:a )?(?:robot|machine|human|real)",
            _always("I am Downbeat, a G1 robot. I listen to music and speech, and I dance."),
        ),
        (
            r"\bwho (?:built|made|created|programmed) you|\bwhere (?:are|do) you (?:come )?from"
            r"|\bhow old are you",
            _always("Unitree built my body, and the Downbeat project taught me to dance."),
        ),
        (
            r"\bhow do you (?:work|dance|balance|hear)|\bhow does (?:it|this) work",
            _always(
                "I recognise the music by its fingerprint, and I simulate every change of dance "
                "before I make it."
            ),
        ),
        (r"\bthank|\bthanks\b|\bmerci\b|\bdanke\b", _always("You are welcome.")),
        (
            r"\bwell done|\bgood job|\bgreat job|\bbravo\b|\b(?:that|it) was (?:great|good|nice"
            r"|beautiful|wonderful|amazing)|\byou are (?:great|funny|cool|awesome|amazing)"
            r"|\bgood robot",
            _always("Thank you, I am glad that you like it."),
        ),
        (r"\bhow are you|\bhow do you feel|\bare you (?:ok|okay|well|tired)",
         _always("I am fine, all my joints are within their limits.")),
        (r"\bcan you hear (?:me|us)|\bdo you hear (?:me|us)|\bare you listening",
         _always("Yes, I can hear you.")),
        (r"\bdo you like (?:music|dancing|to dance)",
         _always("I have no feelings, but I am built to dance.")),
        (r"\bgood (?:morning|evening|afternoon|day)|^(?:hello|hi|hey)\b",
         _always("Hello, nice to meet you.")),
        (r"\bgood ?(?:night|bye)|\bsee you\b", _always("Good bye, see you soon.")),
    )
)  # fmt: skip
"""Pattern of what was said, in small letters -> answer; the first one wins."""
