"""Tide Runner: surf rock in A minor, 140 BPM. Twang through a spring tank, organ, big toms."""

from __future__ import annotations

from downbeat.perception.features import F32
from downbeat.tools.composer import instruments, percussion
from downbeat.tools.composer.desk import Desk, Stem
from downbeat.tools.composer.effects import convolve, highpass, room, spring, tremolo
from downbeat.tools.composer.form import Form
from downbeat.tools.composer.score import Note, chord, grid_hits, near, phrase, root, voicing
from downbeat.tools.composer.waves import F64

FORM = Form(
    "tide_runner",
    "Tide Runner",
    140.0,
    (("intro", 4), ("verse", 8), ("chorus", 8), ("bridge", 8), ("verse2", 8), ("outro", 6)),
    tail_s=2.0,
)
CHORDS = {
    "intro": "Am Am E7 E7",
    "verse": "Am Am Dm Am F E7 Am E7",
    "chorus": "C G Am Em F C Dm E7",
    "bridge": "E7 F E7 F Dm Am F E7",
    "verse2": "Am Am Dm Am F E7 Am E7",
    "outro": "F G F G E7 Am",
}
VERSE = (
    "A3!/.5 A3/.5 C4/.5 E4/.5 A4!/1 G#4/.5 A4/.5 | B4/.5 C5/.5 B4/.5 A4/.5 E4!/1.5 -/.5 |"
    "D4!/.5 D4/.5 F4/.5 A4/.5 D5!/1 C5/.5 B4/.5 | A4/.5 B4/.5 C5/.5 A4/.5 E4!/1.5 -/.5 |"
    "F4!/.5 A4/.5 C5/.5 F5/.5 A5!/1 F5/.5 C5/.5 |"
    "G#4!/.5 B4/.5 D5/.5 E5/.5 F5/.5 E5/.5 D5/.5 B4/.5 |"
    "C5!/1 B4/.5 A4/1.5 -/1 | E4/.5 G#4/.5 B4/.5 D5/.5 E5!/1 -/1"
)
CHORUS = (
    "E5!/1.5 D5/.5 C5/1 G4/1 | D5!/1.5 C5/.5 B4/1 G4/1 | C5!/1.5 B4/.5 A4/.5 C5/.5 E5/1 |"
    "G5!/1 F#5/.5 G5/.5 E5/1 B4/1 | A5!/1.5 G5/.5 F5/1 C5/1 | G5!/1.5 F5/.5 E5/1 C5/1 |"
    "F5!/.5 E5/.5 D5/.5 F5/.5 A5/1 F5/1 | E5!/.5 F5/.5 E5/.5 D5/.5 B4/.5 G#4/.5 E4/1"
)
BRIDGE = (
    "E4!/4 | F4!/2 A4/1 F4/1 | E4!/2 G#4/1 B4/1 | C5!/2 A4/1 F4/1 |"
    "A4!/1 F4/1 D4/1 A4/1 | C5!/1 A4/1 E4/1 C5/1 | F5!/1 E5/1 C5/1 A4/1 | G#4!/1 B4/1 D5/1 E5/1"
)
VERSE2 = (
    "A4!/.5 A4/.5 C5/.5 E5/.5 A5!/1 G#5/.5 A5/.5 | B5/.5 A5/.5 G#5/.5 A5/.5 E5!/1 D5/.5 C5/.5 |"
    "D5!/.5 F5/.5 A5/.5 F5/.5 D5!/1 E5/.5 F5/.5 | E5/.5 C5/.5 A4/.5 C5/.5 E5!/1.5 -/.5 |"
    "F5!/.5 E5/.5 F5/.5 A5/.5 C6!/1 A5/.5 F5/.5 |"
    "E5!/.5 D5/.5 B4/.5 G#4/.5 B4/.5 D5/.5 E5/.5 G#5/.5 |"
    "A5!/1 E5/.5 C5/.5 A4/1 -/1 | E5!/.5 F5/.5 G#5/.5 A5/.5 B5!/1 -/1"
)
OUTRO = (
    "A4!/.5 C5/.5 F5/.5 A5/.5 G5!/1 F5/1 | B4!/.5 D5/.5 G5/.5 B5/.5 A5!/1 G5/1 |"
    "C6!/1 A5/.5 F5/.5 C5/1 A4/1 | D6!/1 B5/.5 G5/.5 D5/1 B4/1 |"
    "E5/.5 F5/.5 G#5/.5 B5/.5 D6/.5 B5/.5 G#5/.5 E5/.5 | A4!/1 E4/.5 C4/.5 A3!/2"
)


def _chords(section: str) -> list[str]:
    return CHORDS[section].split()


def _picked(notes: list[Note], step: float = 0.25) -> list[Note]:
    """Return every note as a run of fast strokes: tremolo picking."""
    strokes = []
    for note in notes:
        for index in range(max(1, round(note.beats / step))):
            strength = note.velocity * (1.0 if index % 2 == 0 else 0.78)
            strokes.append(Note(note.beat + index * step, step * 0.95, note.pitch, strength))
    return strokes


def _bass(section: str) -> list[Note]:
    """Return eighths that walk through each chord and step into the next."""
    symbols = _chords(section)
    notes = []
    for bar, symbol in enumerate(symbols):
        low = root(symbol, 38.0)
        third, fifth = (near(tone, low + 5.0) for tone in chord(symbol)[1:3])
        walk = [low, low, fifth, low, third, low, fifth, low + 12]
        if bar % 2 == 1:
            walk = [low, low, low, fifth, low + 12, fifth, third, low + 2]
        for step, pitch in enumerate(walk):
            notes.append(
                Note(FORM.start(section, bar) + step / 2, 0.44, pitch, 0.9 if step % 2 else 1.0)
            )
    return notes


def _rhythm_guitar(section: str, figure: str) -> list[Note]:
    notes = []
    for bar, symbol in enumerate(_chords(section)):
        for index, (beat, strength) in enumerate(grid_hits(figure, FORM.start(section, bar), 0.5)):
            tones = voicing(symbol, 57.0 + (index + bar) % 3)
            for order, pitch in enumerate(tones):
                notes.append(Note(beat + 0.012 * order, 0.4, pitch, strength))
    return notes


def _organ(section: str) -> list[Note]:
    notes = []
    for bar, symbol in enumerate(_chords(section)):
        figure = "x.x..x.x" if bar % 2 else ".x.xx.x."
        for beat, strength in grid_hits(figure, FORM.start(section, bar), 0.5):
            notes += [Note(beat, 0.3, p, strength) for p in voicing(symbol, 72.0)]
    return notes


def _drums(desk: Desk) -> F64:
    stem = desk.stem()
    for section in ("verse", "chorus", "verse2", "outro"):
        for bar in range(FORM.bars(section)):
            if section == "outro" and bar > 3:
                break
            beat = FORM.start(section, bar)
            # The surf beat: two snares in the middle of the bar.
            stem.hit(percussion.kit_kick, grid_hits("X.......x.x.....", beat), 1.0)
            stem.hit(percussion.snare, grid_hits("....X.x.....X...", beat), 0.8)
            if section == "chorus":
                stem.hit(percussion.ride, grid_hits("x.x.x.x.x.x.x.x.", beat), 0.6)
            else:
                hats = "x.o.x.o.x.o.x.oo" if bar % 2 else "x.o.x.o.x.oox.o."
                stem.hit(percussion.hat, grid_hits(hats, beat), 0.45)
    _jungle(stem, "bridge")
    _fills(stem)
    return stem.samples


def _jungle(stem: Stem, section: str) -> None:
    """Play the bridge's beat on the toms."""
    floors = ("X..x..x.X..x..x.", "X.x.x.x.X..xx.x.", "X..x..x.x.x.X.xx")
    for bar in range(FORM.bars(section)):
        beat = FORM.start(section, bar)
        stem.hit(percussion.tom_low, grid_hits(floors[bar % 3], beat), 0.45)
        stem.hit(percussion.tom_middle, grid_hits("....x.......x.o.", beat), 0.6)
        stem.hit(percussion.kit_kick, grid_hits("x...x...x...x...", beat), 0.6)
        if bar % 2 == 1:
            stem.hit(percussion.crash, [(beat, 1.0)], 0.25)


def _fills(stem: Stem) -> None:
    """A run down the toms into every section, a crash on it."""
    toms = (percussion.tom_high, percussion.tom_middle, percussion.tom_low)
    runs = ("xxxx xxxx xxxx X.X.", "x.xx x.xx xxxx XXXX", "xxx. xxx. xx.x X..X")
    for number, section in enumerate(("verse", "chorus", "bridge", "verse2", "outro")):
        beat = FORM.start(section)
        run = runs[number % len(runs)].split()
        stem.hit(percussion.snare, grid_hits(run[0], beat - 4.0), 0.6)
        for place, drum in enumerate(toms, start=1):
            hits = grid_hits(run[place], beat - 4.0 + place)
            stem.hit(drum, hits, 0.65)
        stem.hit(percussion.crash, [(beat, 1.0)], 0.5)
    last = FORM.start("outro", 4)
    stem.hit(percussion.snare, grid_hits("xxxxxxxxxxxxXXXX", last), 0.5)
    stem.hit(percussion.kit_kick, [(last + 4.0, 1.0), (last + 7.0, 1.0)], 1.0)
    stem.hit(percussion.crash, [(last + 4.0, 1.0), (last + 7.0, 1.0)], 0.5)


def _lead(desk: Desk) -> F64:
    stem = desk.stem()
    guitar = instruments.surf_guitar
    slide = [Note(0.125 * step, 0.12, 69 - step * 0.8, 0.9) for step in range(32)]
    stem.play(guitar, slide)
    stem.play(guitar, phrase("E4!/.5 F4/.5 G#4/.5 B4/.5 A4!/2", FORM.start("intro", 1)))
    stem.play(
        guitar, _picked(phrase("E4/1 G#4/1 B4/1 D5/1 | E5!/2 D5/1 B4/1", FORM.start("intro", 2)))
    )
    stem.play(guitar, phrase(VERSE, FORM.start("verse"), 0.85))
    stem.play(guitar, phrase(CHORUS, FORM.start("chorus"), 0.7))
    stem.play(guitar, _picked(phrase(BRIDGE, FORM.start("bridge"), 0.8, gate=1.0)))
    stem.play(guitar, phrase(VERSE2, FORM.start("verse2"), 0.85))
    stem.play(guitar, phrase(VERSE2, FORM.start("verse2"), 0.5, -12))
    stem.play(guitar, phrase(OUTRO, FORM.start("outro"), 0.85))
    last = [Note(FORM.beats - 1.0, 4.0, pitch, 0.8) for pitch in (45, 52, 57, 60, 64, 69)]
    return stem.play(guitar, last).samples


def play(desk: Desk) -> F32:
    """Return the piece, (n,) at 44.1 kHz, played on `desk`."""
    lead = _lead(desk)
    lead = lead + 0.8 * convolve(lead, spring(1.8, seed=4))
    chords = desk.stem()
    for section, figure in (
        ("verse", "..x...x."),
        ("chorus", ".x.xx.x."),
        ("verse2", "..xx..xx"),
        ("outro", ".xx..xx."),
    ):
        chords.play(instruments.surf_guitar, _rhythm_guitar(section, figure), 0.6)
    bass = desk.stem()
    for section in ("verse", "chorus", "bridge", "verse2"):
        bass.play(instruments.electric_bass, _bass(section), loose_s=0.002)
    bass.play(
        instruments.electric_bass, [n for n in _bass("outro") if n.beat < FORM.start("outro", 5)]
    )
    bass.play(instruments.electric_bass, [Note(FORM.beats - 1.0, 3.0, 33, 1.0)])
    organ = desk.stem()
    for section in ("chorus", "verse2", "outro"):
        organ.play(instruments.organ, _organ(section))
    organ.play(instruments.organ, phrase(CHORUS, FORM.start("chorus"), 0.8, 12))
    desk.mix(_drums(desk), 0.5, -14.0)
    desk.mix(bass.samples, -5.0)
    desk.mix(highpass(lead, 140.0), -11.0, -14.0)
    desk.mix(tremolo(highpass(chords.samples, 180.0), 4.0 / desk.beat_s, 0.5), -2.0, -12.0)
    desk.mix(organ.samples, -8.0, -12.0)
    return desk.master(room(1.1, seed=5))
