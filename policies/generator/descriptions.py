"""What each bundled skill looks like, in people's words: speech is matched with it by meaning.

Phrases (in the choreographies) are short and spoken as commands; these are read, not recognised.
"""

from __future__ import annotations

DESCRIPTIONS: dict[str, tuple[str, ...]] = {
    "armwave": (
        "make your arms roll like the waves of the sea",
        "let a wave run through your arms from one hand to the other",
        "ripple your arms like water",
        "wavy arms dance",
    ),
    "boxstep": (
        "step around a square with your feet",
        "dance a box with your feet",
        "ballroom steps in a square",
    ),
    "disco": (
        "point your finger up to the sky and down like in the seventies",
        "disco dance like John Travolta",
        "do some disco moves",
    ),
    "discostep": (
        "step from side to side in disco style",
        "side steps to disco music",
        "two step disco with your feet",
    ),
    "hipcircle": (
        "move your hips in circles",
        "swing your hips like with a hula hoop",
        "wiggle your waist",
        "belly dance",
    ),
    "kpop": (
        "dance like a Korean pop idol",
        "Korean pop choreography like Gangnam style",
        "dance like BTS",
    ),
    "monkey": (
        "dance like a gorilla, like King Kong",
        "dance like an ape, arms up and down",
        "sixties go-go dancing",
        "swing your arms like a chimp",
    ),
    "pump": (
        "pump your arms to the music",
        "pump your fists in the air",
        "push the ceiling up with your hands",
        "party with your hands up, hype the crowd",
    ),
    "robot": (
        "stiff mechanical dance moves like a machine",
        "popping and locking robot dance",
        "dance mechanically",
    ),
    "salsa": (
        "dance salsa, Cuban party dance",
        "Latin American dance with hips and arms",
        "something spicy and Latin",
    ),
    "salsastep": (
        "salsa footwork forward and back",
        "step a salsa with your feet",
    ),
    "stand": (
        "stand upright and do not move",
        "just stay where you are and be still",
        "take a rest, stand at ease",
    ),
    "sway": (
        "rock softly from side to side",
        "swing slowly with the music",
        "a slow gentle dance",
    ),
    "talk": (
        "gesture with your hands as if you were speaking",
        "make talking gestures",
    ),
    "thriller": (
        "dance like Michael Jackson in the Thriller video",
        "the monster dance with claws, for Halloween",
    ),
    "turnstep": (
        "step and turn your body left and right",
        "dance with turning steps",
    ),
    "tutting": (
        "bend your arms like the figures on an Egyptian wall",
        "make angles with your arms like Egyptian hieroglyphs",
        "walk like an Egyptian arm dance",
        "right-angled hand and arm dance",
    ),
    "twist": (
        "twist your hips and knees like Chubby Checker",
        "rock and roll dance of the sixties, twist and shout",
    ),
    "walk": (
        "walk towards the audience",
        "take some steps towards me",
        "take some steps forward",
        "walk a few metres ahead",
        "go straight on",
        "move over here on your feet",
    ),
    "waltz": (
        "a Viennese ballroom dance in three four time",
        "dance in three quarter time like at a ball",
        "an elegant classical dance",
    ),
    "wave": (
        "wave your hand to greet the people",
        "greet the audience",
        "say hi to everybody",
        "wave goodbye",
    ),
    "zombie": (
        "stumble around like the undead",
        "walk like the living dead with stretched arms",
    ),
}
