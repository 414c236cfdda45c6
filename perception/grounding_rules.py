"""What kind of utterance it is: stop, negation, request, question or statement; before any meaning.

Sentence embeddings are blind to negation ("never do a side kick" is closest to the side kick), so
the form of a sentence is judged by rules, and only requests are matched by meaning.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

from downbeat.perception.grounding_run_on import divided


class Form(Enum):
    """The form of a clause."""

    STOP = "stop"
    NEGATED = "negated"
    """Forbids something."""
    REQUEST = "request"
    """Asks for something in so many words: "can you ...", "let's ...", "show me ..."."""
    BARE = "bare"
    """Neither asks nor states: "salsa", "to the left"; may be a command."""
    OTHER = "other"
    """A question, a statement, small talk."""


@dataclass(frozen=True)
class Clause:
    """One clause of an utterance: its form, and its text without what only makes the form."""

    form: Form
    text: str


_SPLIT = re.compile(
    r"[.;!?:]+(?!\d)|,(?! *(?:with|like|for|in|on|to the|from) )|\bthen\b|\bplease instead\b"
    r"|(?<!anything )(?<!everything )(?<!nothing )(?<!all )(?<!any dance )\bbut\b"
)
"""A comma before "with", "like" and the like divides nothing: what follows tells how."""
_REJECTS = re.compile(
    r"\b(?:instead of|rather than|other than|except(?: for)?|apart from|and not"
    r"|(?<!do )(?<!does )(?<!did )(?<!is )(?<!are )(?<!was )(?<!were )(?<!can )(?<!will )"
    r"(?<!would )(?<!could )(?<!should )(?<!have )(?<!has )(?<!had )(?<!may )(?<!must )not)\b"
)
_PUT_OFF = re.compile(
    r"(?: later| another time| some other time)?"
    r" not (?:now|yet|today|tonight|again|here|this time|any ?more|at the moment|right now)$"
)
"""Forbids what was said before it, for now."""
_WELCOME = re.compile(
    r"^(?:an?|some|a (?:bit|little) of|a little) (?P<wish>.+) would be (?:so |really |very )?"
    r"(?:great|nice|lovely|cool|fun|perfect|awesome|wonderful|good)\b"
)
"""A wish in the form of a statement."""
_IDIOMS = re.compile(
    r"\b(?:you know(?=,|$)|i mean(?=,|$)|if it's (?:no|not too much) (?:trouble|bother)"
    r"|if you (?:don't|do not) mind|don't be (?:shy|afraid)|do not be (?:shy|afraid)"
    r"|don't worry|no worries|no problem|why not|i can't wait(?: to see)?|not bad|no matter)\b"
)
_SAID_OF = (
    r"\b(?:(?:that|it|this|you)(?:'s|'re| is| are| was| go| dance| move)(?: (?:going|dancing"
    r"|moving|a"
    r" bit|a little|far|way|much))* )?(?:not (?:so|too|that|quite so)|too|way too|much too) "
)
_TOO = (
    (re.compile(_SAID_OF + r"(?:fast|quick)\b"), "slower"),
    (re.compile(_SAID_OF + r"slow\b"), "faster"),
)
"""Said of what is going on: a wish for the opposite."""
_POLITE_NOT = re.compile(r"\b(why don't|why do not|can't|couldn't|won't|wouldn't) (you|we)\b")
_NOT = re.compile(
    r"\b(?:don't|dont|do not|never|no more|not|no|without|doesn't|didn't|won't|can't|cannot"
    r"|hate|sick of|tired of|fed up with|forbidden|banned|off limits|isn't|aren't|wasn't"
    r"|shouldn't|mustn't|wouldn't|couldn't|ain't|nobody|nothing|quit|avoid"
    r"|refrain|forget|skip|anything but|neither|nor)\b"
)
_FORBIDS = re.compile(
    r"^(?:(?:and|so|also|ever|just|really) )*(?:don't|dont|do not|never|no more|not|no"
    r"|you (?:mustn't|shouldn't"
    r"|must not|should not|can't|cannot|may not)|i (?:don't|do not|never) want(?: you)?"
    r"|we (?:don't|do"
    r" not) want(?: you)?|quit|avoid|refrain|forget|skip|anything (?:but|except|other than"
    r"|apart from)"
    r"|every(?:thing| dance) (?:but|except)|all but|any dance (?:but|except|other than|apart from)"
    r"|without|leave out|leave off|drop|omit|spare (?:me|us)|save (?:me|us)|lay off|hold off"
    r"|ditch|scrap|cancel|lose the|enough (?:of|with)|no way|hold the"
    r"|the last thing (?:i|we) (?:want|need) is|whatever you do|i'd hate (?:to see)?"
    r"|stay away from|keep away from|no need (?:to|for)|rather not|i forbid|under no"
    r" circumstances|i'd rather you didn't|i would rather you did not)\b"
)

_STOP_WORD = (
    r"(?:stop|stopp|halt|freeze|basta|abort|cease|quit(?: it)?|enough|cut it out|knock it off"
    r"|hold it|hold still|stand still|stay still|keep still|be still|stand down|stay put"
    r"|(?:don't|dont|do not) move|no more (?:dancing|moving|dance|moves)|finish now"
    r"|stay where you are|that's it|that is enough|that's enough|aufhören|arrete|arrête|alto|whoa"
    r"|pause|stahp|stob|stawp|shtop|hault|freez|freese)"
)
_STOP = re.compile(rf"\b{_STOP_WORD}\b")
_STOP_ALONE = re.compile(rf"^{_STOP_WORD}\b")
_GO_ON = re.compile(
    r"\b(?:(?:don't|dont|do not|never|can't|cannot|won't|not|nobody can) (?:ever |you |even )*"
    r"(?:stop|freeze|quit|halt|pause|cease)|without (?:stopping|a pause|stop)|non ?stop"
    r"|keep (?:going|on|it up)|carry on|go on|continue$"
    r"|stop at nothing|(?:bus|pit|full|next) stop|not enough|pause button"
    r"|stop (?:by|for|at|over|talking|worrying|complaining|crying|lying|laughing|smoking|asking"
    r"|recording|filming|singing)"
    r"|(?:stop|freeze|pause|halt) (?:the|this|that|your|my|a|some) (?:car|bus|train|taxi|clock"
    r"|timer|video|recording|film|movie|game|vegetables|leftovers|rest|water|engine|microphone)"
    r"|enough (?:chairs|time|room|space|money|light|food|water|people"
    r"|for (?!today|now|me|us|tonight))|pause for thought)\b"
)

_ADDRESS = re.compile(
    r"^(?:(?:hey|hi|ok|okay|yo|oh|well|so|now|and|alright|all right|come on|dear|mister|mr|listen"
    r"|robot|robbie|downbeat|buddy|friend|my friend|g one|g1|everybody|yes|yeah|sure|please|kindly"
    r"|quickly|just|maybe|perhaps|great|perfect|for me|for us|thanks|um|uh|er|right now"
    r"|go ahead and|sorry|excuse me|again|next|hm) )+"
)
_TAIL = re.compile(
    r"(?: (?:please|now|right now|(?<!the )(?<!a )robot|for me|for us|for the audience"
    r"|for my friends|buddy|mate"
    r"|thanks|thank you|would you|will you|could you|can you|if you like|if you can|okay|ok"
    r"|at once|immediately|instead|with me|a bit|a little|for a while|here|today|tonight|sometime"
    r"|downbeat))+$"
)
_REFUSES = re.compile(
    r"^(?:no|nope|nah|no way|no thanks|no thank you|no no|never|not at all|not now|not today"
    r"|not again|please no|please not)$"
)
"""Takes back what was said before it: "salsa? no thanks"."""
_CALLED = re.compile(
    r"^(?:(?:hey|hi|hello|ok|okay|yo|oh|you|dear|mister|mr|my|little|there|listen) )*"
    r"(?:robot|robbie|downbeat|g one|g1|buddy|mate|friend)$"
)
"""Only calls the robot: a "robot" alone is no robot dance."""
_OTHER_ACTS = re.compile(
    r"^(?:pass(?! an? (?:ripple|wave))|welcome|recommend|suggest|lend|borrow|explain|describe"
    r"|tell|discuss|upload|reset|log|plot|calibrate|recalibrate"
    r"|compile|measure|hand (?:me|us|him|her|over)|bring(?! on)|fetch|buy"
    r"|sell|cook|bake|boil|fry|eat|drink"
    r"|order|taste|pour|serve|open|close|shut|lock|unlock|play (?:the|a|some|that|us|me) (?:song"
    r"|music"
    r"|track|record|playlist|radio|next)|call|phone|ring|send (?!an? (?:arm )?wave|waves)|write"
    r"|read|fix|repair|clean|wash|wipe"
    r"|sweep|charge|plug|unplug|paint|draw|sing|carry|feed|cut|find|look|watch(?! me)|check|remind"
    r"|book|translate|spell|count|help|park|drive|ride|meet|pay|sign|print|scan|delete|download"
    r"|install|reboot|restart|switch (?:on|off)|turn (?:on|off|up|down|the (?:page|light|lights"
    r"|volume|music|sound|key))|put (?:down|away|back|out)|pick up(?! the (?:pace|tempo|speed))"
    r"|take (?:a (?:photo|picture|seat|look|break"
    r"|nap|note|guess)|me|us|him|her|them|care|out|off|away)|get (?:me|us|him|her|off|out|lost|some"
    r" (?:rest|sleep|food|water))|clear|tidy|empty|fill|fold|mop|tie|untie|wake|marry"
    r"|hold (?:this|that|my|the door)|ask|answer|google|search|record|film|mute|dim)\b"
)
"""Work of hands and tongues: asked for, but by nobody who wants a dance."""
_NOTHING = re.compile(
    r"^(?:please|thanks|thank you|robot|now|okay|ok|so|well|hey|yes|yeah|and|just)$"
)
"""No clause of its own: it belongs to the one before it, or to nobody."""
_ASKS = re.compile(
    r"^(?:(?:do you think |i wonder (?:if|whether) |i was wondering (?:if|whether) "
    r"|is there any chance |any chance |i bet )?"
    r"(?:you (?:can|could)|we (?:can|could)(?: get| have| see)?)\b(?: please| maybe| also| do)?"
    r"|(?:would|is) it(?: be)? possible (?:for you )?to(?: see| have| get)?"
    r"|(?:is there )?any chance (?:of|to see|for)(?: seeing| getting)?(?: you)?"
    r"|i was hoping (?:for|to see|you (?:could|would))|i(?:'m| am) in the mood for|i feel like"
    r"|it would be (?:nice|great|lovely|cool|fun) (?:to see|if you (?:could|would)?"
    r"|if we could see)|(?:my|our|the|this) (?:\w+ ){1,3}?(?:wants?|would (?:love|like)|(?:is"
    r"|are) waiting for)(?: for)?(?: to see| to watch)?(?: you)?"
    r"|(?:they|people|everybody|everyone)(?: all)? (?:wants?|would (?:love|like))(?: to see"
    r"| to watch)?(?: you)?|treat us to|feel free to"
    r"|(?:can|could|would|will|won't|can't|couldn't|wouldn't) you(?: please| kindly| maybe"
    r"| perhaps| also)*(?: be so kind(?: as)? to| mind| try to| like to)?"
    r"|(?:can|could|may|might|shall) (?:we|i|you)(?: all)?(?: please)?(?: get| have| see| watch)?"
    r"|(?:i|we)(?: really| just)?(?:'d| would| want| need| wish| wanna)(?: really)?"
    r"(?: love| like| prefer| want)?(?: for)?(?: you)?(?: to)?(?: see| watch| have| get)?(?: you)?"
    r"|let's(?: all)?(?: see| have| try)?|let us(?: see| have| try)?|let me see"
    r"|how about|what about|why don't (?:you|we)|why not|it's time (?:for|to)|it is time (?:for|to)"
    r"|time (?:for|to)|you (?:should|must|have to|need to|could|may|can)(?: now)?|i dare you to"
    r"|i want|we want|your turn to|it's your turn to|now it's time for)\b ?"
)
_DOES = re.compile(
    r"^(?:(?:please|now|show (?:me|us|them|everyone)(?: how to| that you can| how you| your best"
    r"| your| some)?|do(?: me)?(?: your best| your)?|perform|give (?:me|us)|try|start(?: to)?"
    r"|begin(?: to)?"
    r"|(?:show|give|teach) (?:(?:the|my|our|your|that|this) )?[a-z]+(?= (?:a|an|the|your|some"
    r"|that)\b)"
    r"|go(?: and| for(?: an?)?)?|play|start doing|start dancing|dance|dancing|doing|make|let"
    r"|switch(?: over)? to|change to"
    r"|go (?:back )?to|move on to|continue with|keep|busting|bust|pull off|pull|demonstrate|present"
    r"|act|show off|repeat|hit(?: me with)?|bring on|drop into|break into|turn|walk|wave|greet|step"
    r"|move|swing|sway|shake|say|twist|pump|rock|march|come|get|raise|point|circle|wiggle|pretend"
    r"|imitate|be|behave|take|rest|relax|swirl|spin|throw|put|stretch|stomp|stagger|stumble"
    r"|ripple|push|party|shuffle|lurch|limp|wobble|slide|glide|groove|boogie|bounce|roll|lift|reach"
    r"|flap|strike|bend|lean|tilt|rotate|swivel|hula|waltz|salsa|vogue|strut|stride|approach|return"
    r"|execute|run|launch|trigger|activate|initiate|engage|advance)\b ?)+"
)
_ASKS_ABOUT = re.compile(
    r"^(?:do (?:you|we|they|i|people|robots|your|my)|(?:does|did|are|is|was|were|have|has|had)"
    r" (?:you|we|they|i|he|she|it|the|that|this|there|people|robots|your|my)|what|who|whose|when"
    r"|where|why|how|which|tell|explain|describe|(?:is|are|was|were|does|did|has|am)"
    r"|can (?:i|he|she|it|they|people|robots)|could (?:i|he|she|it|they)|remind)\b"
)
_STATES = re.compile(
    r"^(?:i|i'm|i've|i'll|my|me|we|we're|we've|our|he|he's|his|she|she's|her|it|it's|its|they"
    r"|they're|their|you|you're|you've|your|this|that|that's|these|those|there|there's|some|many"
    r"|most|everyone|everybody|people|yesterday|today|tomorrow|tonight|last|in|on|at|after|before"
    r"|because|if|since|while|once upon|good|thank|thanks|mom|dad|one of|all|every|both|usually"
    r"|sometimes|often|always|nice|great|wow|cool|someone|somebody|robots|dancers|kids|children)\b"
)
_TELLS = re.compile(
    r"^(?:the|a|an)\b.*\b(?:is|are|was|were|will|should|could|would|can|may|might|must|does|did"
    r"|has|have|had|looks?|smells?|tastes?|sounds?"
    r"|broke|went|stole|ate|ran|gave|saw|found|drank|threw|kept|told|knew|thought|brought"
    r"|bought|caught|taught|sang|flew|drove|wrote|rode|slept|spoke|stood|won|lost|wore|sat|felt"
    r"|came|goes|comes|got|gets|lives?|hit|fell|needs?|costs?|starts?|ends?|closed?|opens?|said"
    r"|says|made|makes|took|takes|[a-z]{3,}ed)\b"
)
"""A thing and what became of it: "the salsa was too spicy"."""
_IS_SO = re.compile(
    r"^\w.* (?:is|are|was|were|isn't|looks|sounds) (?:my|your|his|her|our|their|the|a"
    r"|an|so|very|too|really|quite|not|out|in|on|at|from|broken|ready|great|fun|hard|easy|\w+ing)\b"
)


def plain(text: str) -> str:
    """Return the text in small letters with straight apostrophes and single spaces."""
    return " ".join(text.lower().replace("’", "'").replace("`", "'").split())


def is_address(text: str) -> bool:
    """Whether a text in small letters only calls the robot."""
    return bool(_CALLED.match(text))


def clauses(text: str) -> list[Clause]:
    """Return the clauses of an utterance, in order."""
    cleaned = _IDIOMS.sub(" ", plain(text))
    for wish, opposite in _TOO:
        cleaned = wish.sub(opposite, cleaned)
    cleaned = _POLITE_NOT.sub(
        lambda m: {"won't": "will", "can't": "can"}.get(m[1], "could") + " you", cleaned
    )
    found = []
    for part in _SPLIT.split(cleaned):
        part = re.sub(r"[^\w'.äöüàéèêß -]", " ", part)
        part = " ".join(part.strip(" .-").split())
        if _REFUSES.match(part):
            found = [one for one in found if one.form not in (Form.REQUEST, Form.BARE)]
        for piece in divided(part):
            if not _NOTHING.match(piece):
                found += _judge(piece)
    return found


def _judge(part: str) -> list[Clause]:
    bare = _TAIL.sub("", _ADDRESS.sub("", part + " ").strip()).strip() or part
    is_statement = bool(_STATES.match(bare)) and not _ASKS.match(bare)
    goes_on = _GO_ON.search(bare)
    if _STOP.search(bare) and not goes_on:
        about = _ASKS_ABOUT.match(bare) or (is_statement and not _STOP_ALONE.match(bare))
        starts = re.match(r"^(?:the|a|an)\b", bare)
        if not about and not starts:
            return [Clause(Form.STOP, bare)]
    if goes_on:
        return [Clause(Form.OTHER, bare)]
    if _FORBIDS.match(bare):
        return [Clause(Form.NEGATED, _FORBIDS.sub("", bare).strip())]
    if (put_off := _PUT_OFF.search(part)) and not is_statement:
        return [Clause(Form.NEGATED, part[: put_off.start()].strip())]
    if welcome := _WELCOME.match(bare):
        return [Clause(Form.REQUEST, welcome["wish"])]
    if (split := _REJECTS.search(bare)) and split.start() > 0 and not is_statement:
        head, tail = bare[: split.start()].strip(), bare[split.end() :].strip()
        return [*_judge(head), Clause(Form.NEGATED, tail)]
    if _NOT.search(bare):
        return [Clause(Form.OTHER, bare)]
    if is_address(bare):
        return [Clause(Form.OTHER, bare)]
    if asks := _ASKS.match(bare):
        rest = bare[asks.end() :].strip()
        rest = _ADDRESS.sub("", rest + " ").strip()
        if _FORBIDS.match(rest):
            return [Clause(Form.NEGATED, _FORBIDS.sub("", rest).strip())]
        form = Form.OTHER if _OTHER_ACTS.match(rest) else Form.REQUEST
        return [Clause(form, rest or bare)]
    if _OTHER_ACTS.match(bare):
        return [Clause(Form.OTHER, bare)]
    if _ASKS_ABOUT.match(bare):
        return [Clause(Form.OTHER, bare)]
    if _DOES.match(bare):
        return [Clause(Form.REQUEST, bare)]
    if _STATES.match(bare) or _TELLS.match(bare) or _IS_SO.search(bare):
        return [Clause(Form.OTHER, bare)]
    return [Clause(Form.BARE, bare)]
