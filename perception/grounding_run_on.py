"""Sentences that run on without a comma, as recognisers write them.

"okay so what i want is a waltz because my grandma loves it" asks for a waltz: what comes before it
and after it is taken away or made a clause of its own, so that the form of each can be judged.
"""

from __future__ import annotations

import re

_PRAISE = r"(?:great|good|nice|fun|cool|awesome|lovely|amazing|wonderful|funny|brilliant|fantastic)"
_OPENINGS = re.compile(
    r"^(?:(?:(?:okay|ok|so|well|and|now|right|alright|hey|hi|hello|robot|please|um|uh|erm|hmm|listen"
    r"|mister|mr|then|yes|yeah|good (?:morning|evening|afternoon)|oh|wow|cool|yay"
    r"|ladies and gentlemen|boys and girls|everybody|everyone|my (?:dear |little )?friends?"
    r"|let me (?:think|see)(?= (?:i|could|can|do|maybe|how|what|let's))"
    r"|i think|i guess|i say|i said|you know what|guess what"
    r"|(?:the )?next (?:one|test|thing)?(?: is)?"
    r"|(?:what|all) (?:i|we)(?:'d| would)?(?: really| now)? (?:want|wanted|need|like|love)"
    r"(?: now)?(?: to (?:see|watch|have))?(?: now)?(?: from you)?(?: is| was)?"
    r"(?: for)?(?: you)?(?: to)?|my (?:favourite|favorite)(?: (?:dance|one|move))? is"
    r"|(?:it's|it is) my turn(?: now)?(?: and)?|i'm bored|we are ready|we're ready|i'm ready|ready"
    r"|dear (?:\w+ )?(?:viewers|guests|friends|audience|children|ladies|people|robot)"
    r"|welcome everybody|i have (?:a|one) (?:wish|request|idea|question)"
    r"|if you (?:could|can|would)(?: please)?"
    r"(?= (?:do|dance|perform|show|give|wave|walk|twist|sway|pump|try|make)\b)"
    r"|attention|action|command|here we go"
    r"|the (?:next|following) (?:dance|move|number|song)(?: (?:is|will be))?(?: going to be)?"
    r"|(?:and )?(?:our|my|the|this) (?:\w+ )?(?:robot|friend)(?: here)? (?:will|is going to|shall)"
    r"(?: now)?(?=(?: now)? (?:do|dance|perform|show|present|give|wave|walk|twist|sway)\b))) )+"
)
"""What leads up to a wish; some of them are no more than a breath."""
_LATER = re.compile(
    r"(?<= )(?:because|'cause|cause|so that|so (?:we|i|they|everybody|everyone|he|she) can"
    r"|since (?:we|i|it|my|the|they|you|this)|if (?:that's|that is|it's|it is) (?:okay|ok|possible"
    r"|all right|alright)|if you (?:want|like|wish|please|can|could|would|know (?:it|how|that))"
    r"|when(?:ever)? you(?:'re| are) ready|as (?:fast|good|well|best|long) as (?:you|it)"
    r"|before (?:we|i|you|they) (?:go|leave|start|finish|close)|while (?:i|we|they|the)"
    r"|and (?:i|we|they) will (?:watch|clap|film)|that would be \w+|it(?:'s| is| will be) \w+ fun"
    r")\b"
    r"(?P<tail>.*)$"
)
"""Why, and if it pleases: nothing of what is wanted."""
_FOR_WHOM = re.compile(
    r"(?<= )for (?:(?:the|my|our|your|all the|all|these|those)"
    r" (?:little |small |lovely |dear |nice )?(?:kids|children|people|audience|viewers|guests"
    r"|ladies|girls|boys|cameras?|class|family|mum|mom|mother|dad|father|grandma|granny|grandpa"
    r"|grandmother|grandfather|sister|brother|friends?|son|daughter|baby|public|visitors|crowd|video|test|demo"
    r"|log|record|recording|spectators)|everybody|everyone|me|us|them|him|her)"
    r"(?: (?:at home|over there|here|tonight|today|now|in the studio))?(?= |$)"
)
_SHOW_TO = re.compile(
    r"\b(show|present|demonstrate|perform) (?:please )?to"
    r" (?:us|me|them|everyone|everybody|(?:our|the|my) \w+)(?= )"
)
_WHY_FIRST = re.compile(
    r"^(?:because|as|since) (?:\w+ ){1,8}?(?=(?:i|we) (?:want|would|'d|need)\b|(?:i|we)'d\b"
    r"|please\b|can you\b|could you\b|show (?:me|us)\b|let's\b|dance (?:a|the|some)\b"
    r"|do (?:a|the|some)\b)"
)
_CUE = (
    r"(?:(?:so |and |now |then )*(?:please |kindly )?"
    r"(?:can|could|would|will) you(?: please)?"
    r"|let's|please (?!him|her|them|everyone|everybody|note)"
    r"|(?:show|give|teach) (?:me|us|them|him|her|everyone|everybody|the (?:kids|children|people"
    r"|audience))"
    r"|how about|do (?:it|that) (?:again|once|one)|why don't you)"
)
_NEW_WISH = re.compile(
    rf"(?<!^)(?<!\bif)(?<!\bhow)(?<!\bwhat)(?<!\bwhen)(?<!\bwhere)(?<!\bwho)(?<!\bwhy)(?<!\bthat)"
    rf"(?<!\bto)(?<!\bthink)(?<!\bwonder)(?<!\bthey)(?<!\bi)(?<!\bwe)(?<!\byou)(?<!\bnot)"
    rf"(?<!\bdon't)(?<!\bdidn't)(?<!\bnever)(?<!\bhe)(?<!\bshe)(?<!\bwill)(?<!\bcan)"
    rf"(?<!\bwould)(?<!\bcould)(?<!\bshould)(?<!\bmust)(?<!\bthings)(?<!\bdances)(?<!\banything)"
    rf"(?<!\beverything)(?<!\bor)(?<!\bdid)(?<!\bdo)(?<!\bas)(?<!\bno)(?<!\bhim)(?<!\bher)"
    rf"(?<!\bthem)(?<!\bme)(?<!\bus)(?<!\band) (?={_CUE}\b)"
)
"""Where a statement ends and a wish begins; not after who does it, nor inside a question."""
_THEN_DO = re.compile(
    rf"^(?P<said>(?:that|this|it)(?:'s| is| was) (?:\w+ )?{_PRAISE}"
    r"|(?:it's|it is|today is) (?:my |her |his |our )?(?:halloween|christmas|birthday|carnival"
    r"|showtime|party time|friday|saturday|new year)(?: (?:today|now|tonight))?"
    r"|well done|very good|bravo|thank you|thanks|good (?:job|boy|robot)) (?:and |now |so |then )*"
    r"(?=(?:do|dance|show|play|repeat|once|one|again|another|give|please|walk|wave|sway|twist|stop"
    r"|go|come|pump|move|slower|faster|a bit|make|act|be|step|turn|swing|rock)\b)"
)
_STATED = re.compile(
    r"^(?:i|i'm|my|we|we're|our|he|she|it|it's|they|this|that|that's|there|the|a|everyone|everybody"
    r"|today|tonight|yesterday|people|some|kids|children|mum|dad|grandma|grandpa)\b"
)


def divided(part: str) -> list[str]:
    """Return the clauses of a part between two commas, each without what leads up to a wish.

    Args:
        part: Small letters, no marks but apostrophes, points in numbers and hyphens.
    """
    part = _THEN_DO.sub(lambda m: m["said"] + " ; ", part)
    if _STATED.match(part):
        part = _NEW_WISH.sub(" ; ", part)
    found = []
    for piece in part.split(" ; "):
        piece = _SHOW_TO.sub(r"\1 us", _WHY_FIRST.sub("", _FOR_WHOM.sub("", piece.strip())))
        short = _OPENINGS.sub("", piece.strip() + " ").strip() or piece.strip()
        later = _LATER.search(short)
        # A condition that forbids ("if it is not ...") is no mere politeness.
        if later and not re.search(r"\b(?:not|n't|don't|never|stop|instead)\b", later["tail"]):
            short = short[: later.start()].strip() or short
        if short:
            found.append(short)
    return found
