"""Salsa del Puerto: salsa in D minor, 98 BPM. Son clave 2-3, montuno, tumbao, congas, brass.

A bar of four beats holds one clave, which is two bars of the musicians' cut time; so a bar has
sixteen steps and two chords.
"""

from __future__ import annotations

from downbeat.perception.features import F32
from downbeat.tools.composer import instruments, percussion
from downbeat.tools.composer.desk import Desk, Stem
from downbeat.tools.composer.effects import echo, highpass, room
from downbeat.tools.composer.form import Form
from downbeat.tools.composer.score import Note, chord, grid_hits, near, phrase, root, voicing
from downbeat.tools.composer.waves import F64

FORM = Form(
    "salsa_del_puerto",
    "Salsa del Puerto",
    98.0,
    (("intro", 4), ("verse", 6), ("coro", 6), ("mambo", 6), ("coro2", 6), ("outro", 2)),
    tail_s=1.5,
)
HALVES = {
    "intro": "Dm Dm Gm A7 Dm Bb A7 A7",
    "verse": "Dm Gm C7 F Bb Gm A7 Dm Gm Dm A7 A7",
    "coro": "Dm Gm A7 Dm Dm Gm A7 Dm Gm Gm A7 A7",
    "mambo": "Bb C7 F Dm Bb C7 F Dm Gm A7 Dm A7",
    "coro2": "Dm Gm A7 Dm Bb Gm A7 Dm Gm C7 F A7",
    "outro": "Dm A7 Dm Dm",
}
CLAVE = "..x.x... x..x..x."
CASCARA = "X.xxx.x. X.xx.x.x"
BELL = "X.xxX.x. X.xxX.xx"
MONTUNO = (0, 2, 3, 5, 7, 9, 11, 13, 15)

VERSE = (
    "-/.5 A4/.25 D5/.25 F5!/.75 E5/.25 D5/.5 G5!/.75 F5/.25 D5/.5 |"
    "E5/.25 G5/.5 E5!/.5 C5/.5 D5/.25 C5/.5 A4/1 -/.5 |"
    "-/.25 D5/.25 F5/.5 A#5!/.75 A5/.25 G5/.5 F5/.5 G5/.5 D5/.5 |"
    "E5!/.75 C#5/.25 E5/.5 G5/.5 F5/.75 E5/.25 D5/1 |"
    "-/.5 G5/.5 A#5!/.5 A5/.5 A5/.25 F5/.75 D5/.5 A4/.5 |"
    "C#5/.5 E5/.5 G5!/.75 A#5/.25 A5/1 -/1"
)
CORO = (
    "D5!/.5 F5/.25 A5/.5 F5/.25 G5/.5 A#5!/.75 A5/.25 G5/.5 -/.5 |"
    "A5/.5 G5/.25 E5/.5 C#5/.25 D5/1 -/1.5 |"
    "D5!/.5 F5/.25 A5/.5 D6/.25 C6/.5 A#5!/.75 G5/.25 A#5/.5 -/.5 |"
    "A5/.25 A#5/.25 A5/.25 G5/.25 E5/.5 F5/1 -/1.5 |"
    "G5!/.75 A5/.25 A#5/.5 D6/.5 A#5!/.75 A5/.25 G5/.5 -/.5 |"
    "C#6!/.75 A5/.25 E5/.5 G5/.5 A5/1.5 -/.5"
)
MAMBO = (
    "D5!/.25 F5/.25 A#5/.5 -/.25 A#5/.25 D6/.5 C6!/.25 -/.25 G5/.25 C6/.25 E6/.5 -/.5 |"
    "C6!/.25 A5/.25 F5/.5 -/.25 A5/.25 C6/.5 A5!/.75 F5/.25 D5/.5 -/.5 |"
    "A#5!/.25 -/.25 A#5/.25 D6/.25 F6/.75 D6/.25 E6!/.25 -/.25 C6/.25 G5/.25 C6/.5 -/.5 |"
    "A5!/.5 C6/.25 F6/.75 C6/.5 D6!/.75 A5/.25 F5/.5 -/.5 |"
    "G5!/.25 A5/.25 A#5/.25 D6/.25 G6!/.75 F6/.25 E6!/.25 C#6/.25 A5/.25 C#6/.25 E6/.75 -/.25 |"
    "F6!/.5 D6/.25 A5/.25 D6/.5 -/.5 C#6!/.25 -/.25 E6/.25 -/.25 A6!/.75 -/.25"
)
ANSWERS = "-/2 A4!/.25 -/.25 D5/.25 -/.25 F5!/.75 -/.25"
INTRO = (
    "D5!/.25 -/.25 D5/.25 F5/.25 A5!/.75 -/.25 -/2 | G5!/.25 -/.25 G5/.25 A#5/.25 A5!/.75 -/2.25 |"
    "D5!/.25 -/.25 D5/.25 F5/.25 A5!/.5 D6/.5 A#5!/.75 A5/.25 G5/.5 F5/.5 |"
    "E5!/.75 C#5/.75 E5/.5 A5!/.25 -/.25 A5/.25 -/.25 A5!/.75 -/.25"
)


def _halves() -> list[tuple[float, str]]:
    """Return (beat, chord) of every half bar of the piece."""
    rows = []
    for section, _ in FORM.sections:
        symbols = HALVES[section].split()
        rows += [(FORM.start(section) + 2.0 * index, name) for index, name in enumerate(symbols)]
    return rows


def _tumbao() -> list[Note]:
    """Return the bass: it plays the next chord's root half a beat before the chord comes."""
    halves = _halves()
    notes = [Note(0.0, 0.7, root(halves[0][1], 38.0), 1.0)]
    for index, (beat, symbol) in enumerate(halves[:-2]):
        following = halves[index + 1][1]
        fifth = near(chord(symbol)[2], 38.0)
        third = near(chord(symbol)[1], 40.0)
        notes.append(Note(beat + 0.75, 0.7, fifth if index % 4 else third, 0.85))
        notes.append(Note(beat + 1.5, 1.1, root(following, 38.0), 1.0))
        if index % 8 == 7:
            notes.append(Note(beat + 1.25, 0.2, near(chord(symbol)[0], 45.0), 0.7))
    notes.append(Note(halves[-1][0], 2.5, root("Dm", 38.0), 1.0))
    return notes


def _montuno(section: str, velocity: float, figure: int) -> list[Note]:
    """Return the piano's pattern: chord tones in octaves against the clave, `figure` varies it."""
    symbols = HALVES[section].split()
    notes = []
    for bar in range(FORM.bars(section)):
        for order, step in enumerate(MONTUNO):
            # A step on the last sixteenth already belongs to the next chord.
            half = min(2 * bar + (step + 1) // 8, len(symbols) - 1)
            tones = voicing(symbols[half], 67.0)
            climb = (
                (0, 2, 1, 2, 0, 1, 2, 1, 0)
                if (bar + figure) % 2 == 0
                else (2, 0, 1, 0, 2, 1, 0, 1, 2)
            )
            pitch = tones[climb[order] % len(tones)]
            if figure and order in (2, 6):
                pitch = tones[-1] + (0 if bar % 3 else 2)
            beat = FORM.start(section, bar) + step / 4
            accent = 1.0 if step in (0, 3, 7, 11) else 0.75
            for octave in (-12, 0, 12):
                notes.append(
                    Note(beat, 0.22, pitch + octave, velocity * accent * (0.7 if octave else 1.0))
                )
    return notes


def _congas(stem: Stem, section: str) -> None:
    for bar in range(FORM.bars(section)):
        beat = FORM.start(section, bar)
        stem.hit(
            percussion.conga_touch,
            grid_hits("oo.o o... oo.oo...", beat),
        )
        stem.hit(percussion.conga_slap, grid_hits("..x..... ..x...o.", beat))
        high = "......xx ......x." if bar % 2 == 0 else "......xx ...x..xx"
        stem.hit(percussion.conga_high, grid_hits(high, beat))
        low = "........ .......x" if bar % 2 == 0 else "...xx... ........"
        stem.hit(percussion.conga_low, grid_hits(low, beat))


def _percussion(desk: Desk) -> F64:
    stem = desk.stem()
    for section, bars in FORM.sections:
        if section == "outro":
            continue
        _congas(stem, section)
        is_loud = section in ("coro", "mambo", "coro2")
        for bar in range(bars):
            beat = FORM.start(section, bar)
            stem.hit(percussion.claves, grid_hits(CLAVE, beat), 0.38)
            shaken = "x.oox.oo x.oox.oo" if bar % 2 else "x.oxx.oo x.oox.ox"
            stem.hit(percussion.shaker, grid_hits(shaken, beat), 0.38)
            if is_loud:
                stem.hit(percussion.cowbell, grid_hits(BELL, beat), 0.42)
                stem.hit(percussion.guiro, grid_hits("X.......X.......", beat), 0.35)
                stem.hit(percussion.kick, grid_hits("...x..x....x..x.", beat), 0.25)
            elif section == "verse" or bar >= 2:
                stem.hit(percussion.shell, grid_hits(CASCARA, beat), 0.42)
    _fills(stem)
    return stem.samples


def _fills(stem: Stem) -> None:
    """Timbales run into every section; a crash opens it."""
    timbales = (percussion.timbale_high, percussion.timbale_low)
    runs = ("x.xx x.xx X.X.", "..xx xxxx X..X", "x.x. xxx. XXXX")
    for number, section in enumerate(("verse", "coro", "mambo", "coro2", "outro")):
        beat = FORM.start(section)
        run = runs[number % len(runs)]
        stem.hit(timbales[number % 2], grid_hits(run, beat - 3.0), 0.6)
        stem.hit(percussion.timbale_low, grid_hits("x..x", beat - 1.0), 0.6)
        stem.hit(percussion.crash, [(beat, 1.0)], 0.4)
    last = FORM.start("outro")
    for beat in (0.0, 0.75, 1.5, 2.5, 3.0, 4.0):
        stem.hit(percussion.crash, [(last + beat, 1.0)], 0.2 if beat < 4.0 else 0.45)
        stem.hit(percussion.conga_low, [(last + beat, 1.0)], 0.9)
        stem.hit(percussion.timbale_high, [(last + beat, 1.0)], 0.7)


def _brass(desk: Desk) -> F64:
    stem = desk.stem()
    stem.play(instruments.brass, phrase(INTRO, 0.0, 0.8))
    stem.play(instruments.brass, phrase(INTRO, 0.0, 0.6, -12))
    for bar in (1, 3, 5):
        stem.play(instruments.brass, phrase(ANSWERS, FORM.start("verse", bar), 0.5))
    mambo = FORM.start("mambo")
    stem.play(instruments.brass, phrase(MAMBO, mambo, 0.85))
    stem.play(instruments.brass, phrase(MAMBO, mambo, 0.55, -12))
    second = FORM.start("coro2")
    stem.play(instruments.brass, phrase(CORO, second, 0.7, -12))
    for bar in (1, 3, 5):
        riff = "-/2 D6!/.25 -/.25 A5/.25 D6/.25 F6!/.5 -/.5"
        stem.play(instruments.brass, phrase(riff, second + 4.0 * bar, 0.7))
    hits = "D5!/.5 -/.25 D5/.5 -/.25 F5!/.5 -/.5 A5!/.25 -/.25 C#6!/.75 -/.25 D6!/1.5 -/2.5"
    for transpose in (0, -5, -12):
        stem.play(instruments.brass, phrase(hits, FORM.start("outro"), 0.75, transpose))
    return stem.samples


def _melody(desk: Desk) -> F64:
    stem = desk.stem()
    stem.play(instruments.flute, phrase(VERSE, FORM.start("verse"), 0.9))
    stem.play(instruments.flute, phrase(CORO, FORM.start("coro"), 0.9))
    stem.play(instruments.soft_lead, phrase(CORO, FORM.start("coro"), 0.5, -12))
    stem.play(instruments.flute, phrase(CORO, FORM.start("coro2"), 0.9, 0))
    return stem.samples


def play(desk: Desk) -> F32:
    """Return the piece, (n,) at 44.1 kHz, played on `desk`."""
    piano = desk.stem()
    for section, velocity, figure in (
        ("intro", 0.7, 0),
        ("verse", 0.75, 0),
        ("coro", 0.9, 1),
        ("mambo", 0.8, 2),
        ("coro2", 0.9, 3),
    ):
        piano.play(instruments.piano, _montuno(section, velocity, figure))
    last = [Note(FORM.start("outro", 1), 3.5, pitch, 0.9) for pitch in (50, 57, 62, 65, 69, 74)]
    piano.play(instruments.piano, last)
    bass = desk.stem().play(instruments.upright_bass, _tumbao())
    melody = _melody(desk)
    melody += 0.5 * echo(melody, 0.75 * desk.beat_s, 0.25)
    desk.mix(_percussion(desk), -2.0, -14.0)
    desk.mix(highpass(piano.samples, 120.0), -5.5, -14.0)
    desk.mix(bass.samples, -4.0)
    desk.mix(_brass(desk), -6.0, -9.0)
    desk.mix(melody, -8.0, -9.0)
    return desk.master(room(1.3, seed=2, brightness_hz=6_500.0))
