"""Midnight Bones: horror funk in E minor, 116 BPM. Slap bass, organ, clavinet-like guitar, choir.

The bridge quotes the Dies irae, a chant of the thirteenth century.
"""

from __future__ import annotations

from downbeat.perception.features import F32
from downbeat.tools.composer import instruments, percussion
from downbeat.tools.composer.desk import Desk, Stem
from downbeat.tools.composer.effects import echo, highpass, room, swept_lowpass
from downbeat.tools.composer.form import Form
from downbeat.tools.composer.score import Note, grid_hits, held_chords, phrase, root, voicing
from downbeat.tools.composer.waves import F64

FORM = Form(
    "midnight_bones",
    "Midnight Bones",
    116.0,
    (("intro", 4), ("verse", 8), ("chorus", 8), ("bridge", 6), ("chorus2", 8), ("outro", 2)),
    tail_s=3.0,
)
CHORDS = {
    "intro": "Em Em C B7",
    "verse": "Em Em Am Em Em G Am B7",
    "chorus": "Em C Am B7 Em C F#dim B7",
    "bridge": "Em Em Am C F#dim B7",
    "chorus2": "Em C Am B7 Em C F#dim B7",
    "outro": "C B7",
}
RIFFS = (
    "E2!/.5 -/.25 E2/.25 G2!/.5 A2/.25 A#2/.25 B2!/.5 -/.25 D3/.25 E3!/.25 -/.25 D2/.5",
    "E2!/.5 -/.25 E3/.25 D3!/.25 B2/.25 A2/.25 G2/.25 E2!/.5 -/.5 G2/.25 A2/.25 B2/.25 D3/.25",
    "E2!/.75 E3!/.25 -/.25 E2/.25 D3/.25 E3/.25 -/.5 B2!/.25 A2/.25 G2/.25 F#2/.25 E2/.5",
)
VERSE = (
    "-/.5 E5/.5 G5!/.5 F#5/.25 E5/.25 B4/1 -/1 |"
    "-/.5 E5/.5 G5!/.5 A5/.5 B5/.75 A5/.25 G5/.5 E5/.5 |"
    "-/.5 C5/.5 E5!/.75 D5/.25 C5/.5 A4/.5 B4/.5 C5/.5 | B4!/1.5 G4/.5 E4/1 -/1 |"
    "-/.5 B5/.5 B5!/.25 A5/.25 G5/.5 E5/1 -/.5 D5/.5 | D5!/.75 G5/.75 B5/.5 A5/.5 G5/.5 D5/1 |"
    "C5!/.5 E5/.5 A5/.75 G5/.25 E5/1 D5/.5 C5/.5 | B4/.5 D#5/.5 F#5!/.5 A5/.5 G5/.5 F#5/.5 D#5/1"
)
CHORUS = (
    "E5!/.75 B5/.75 G5/.5 F#5/.5 E5/.5 G5/1 | C6!/.75 B5/.75 G5/.5 E5/2 |"
    "C6!/.75 A5/.75 E5/.5 G5/.5 A5/.5 C6/1 | B5!/.75 A5/.75 F#5/.5 D#5/1 B4/1 |"
    "E5!/.75 B5/.75 E6/.5 D6/.5 B5/.5 G5/1 | C6!/.75 D6/.75 E6/.5 D6/.5 C6/.5 G5/1 |"
    "A5!/.75 C6/.75 E6/.5 C6/.5 A5/.5 F#5/1 | D#6!/.75 B5/.75 A5/.5 F#5/1 B4/1"
)
DIES_IRAE = (
    "G5/1 F#5/1 G5/1 E5/1 | F#5/1 D5/1 E5!/2 | A5/1 G5/.5 A5/.5 C6/1 B5/1 |"
    "G5/1 E5/1 G5!/1 C6/1 | A5/1 C6/.5 A5/.5 F#5!/2 | D#5/.5 F#5/.5 A5/.5 B5/.5 D#6!/2"
)
ORGAN_FIGURES = ("x..x..x. x..x.x..", "..x..x.. x.x..x.x", "x.x...x. ..xx..x.")


def _chords(section: str) -> list[str]:
    return CHORDS[section].split()


def _bass(section: str) -> list[Note]:
    """Return the riff, moved to each bar's chord."""
    notes = []
    for bar, symbol in enumerate(_chords(section)):
        move = root(symbol, 42.0) - 40
        riff = RIFFS[(bar + bar // 4 + (section == "chorus2")) % len(RIFFS)]
        notes += phrase(riff, FORM.start(section, bar), 0.85, move, gate=0.8)
    return notes


def _stabs(section: str, centre: float, velocity: float) -> list[Note]:
    """Return chords struck on a funk rhythm that changes from bar to bar."""
    notes = []
    for bar, symbol in enumerate(_chords(section)):
        figure = ORGAN_FIGURES[(bar * 2 + len(section)) % len(ORGAN_FIGURES)]
        for beat, strength in grid_hits(figure, FORM.start(section, bar)):
            notes += [Note(beat, 0.2, p, velocity * strength) for p in voicing(symbol, centre)]
    return notes


def _scratch(section: str) -> list[Note]:
    """Return the muted guitar: sixteenths around two tones of the chord."""
    notes = []
    for bar, symbol in enumerate(_chords(section)):
        tones = voicing(symbol, 64.0)
        figure = "x.xo.xo. x.ox.oxo" if bar % 2 else "xo.x.oxo .x.xo.x."
        for index, (beat, strength) in enumerate(grid_hits(figure, FORM.start(section, bar))):
            pitch = tones[(index + bar) % len(tones)] + (12 if index % 5 == 4 else 0)
            notes.append(Note(beat, 0.18, pitch, strength))
    return notes


def _drums(desk: Desk) -> F64:
    stem = desk.stem()
    kicks = ("x.....x. ..x....x", "x..x..x. ..x.....", "x.....xx ..x..x..")
    for section in ("verse", "chorus", "chorus2"):
        for bar in range(FORM.bars(section)):
            beat = FORM.start(section, bar)
            stem.hit(percussion.kit_kick, grid_hits(kicks[bar % 3], beat), 1.0)
            stem.hit(percussion.snare, grid_hits("....X..o .o..X..o", beat), 0.8)
            hats = "x.xox.xo x.xoxoxo" if bar % 2 else "x.xox.x. xoxox.xo"
            stem.hit(percussion.hat, grid_hits(hats, beat), 0.36)
            stem.hit(percussion.open_hat, grid_hits("......x. ........", beat), 0.4)
            if section != "verse":
                stem.hit(percussion.clap, grid_hits("....x... ....x...", beat), 0.55)
                stem.hit(percussion.cowbell, grid_hits("x...x.x. x...x...", beat), 0.4)
    for bar in range(FORM.bars("bridge")):
        beat = FORM.start("bridge", bar)
        stem.hit(percussion.kit_kick, grid_hits("x....... ...x....", beat), 1.0)
        stem.hit(percussion.snare, grid_hits("........ X.......", beat), 0.85)
        stem.hit(percussion.rim, grid_hits("..o..o.o ..o.o..o", beat), 0.5)
    for bar in range(4):
        stem.hit(percussion.rim, grid_hits("x..x..x. ....x.o.", FORM.start("intro", bar)), 0.5)
        stem.hit(percussion.kit_kick, grid_hits("x.x..... ........", FORM.start("intro", bar)), 0.8)
    _fills(desk, stem)
    return stem.samples


def _fills(desk: Desk, stem: Stem) -> None:
    for number, section in enumerate(("verse", "chorus", "bridge", "chorus2", "outro")):
        beat = FORM.start(section)
        stem.hit(percussion.crash, [(beat, 1.0)], 0.5)
        snares = ("..xx.xXX", "x.x.xxXX", "xx.xx.XX")[number % 3]
        stem.hit(percussion.snare, grid_hits(snares, beat - 2.0), 0.6)
        toms = (percussion.tom_high, percussion.tom_middle, percussion.tom_low)
        for drum, place in zip(toms, (-2.0, -1.5, -1.0)):
            stem.hit(drum, grid_hits("x.", beat + place), 0.6)
        stem.sound(percussion.riser(2.0 * desk.beat_s, number), beat - 2.0, 0.25)


def _atmosphere(desk: Desk) -> F64:
    """Wind, the bell of the tower, and the choir."""
    stem = desk.stem()
    stem.sound(percussion.wind(18.0 * desk.beat_s, 0), 0.0, 0.5)
    stem.sound(percussion.wind(26.0 * desk.beat_s, 2), FORM.start("bridge") - 1.0, 0.35)
    stem.sound(percussion.wind(10.0 * desk.beat_s, 4), FORM.start("outro"), 0.4)
    tolls = [(0.0, 52), (8.0, 52), (FORM.start("bridge"), 52), (FORM.start("outro"), 48)]
    stem.play(instruments.church_bell, [Note(beat, 6.0, pitch, 1.0) for beat, pitch in tolls], 0.8)
    end = FORM.beats
    stem.play(instruments.church_bell, [Note(end, 6.0, 52, 1.0)], 1.1)
    return stem.samples


def _choir(desk: Desk) -> F64:
    stem = desk.stem()
    for section, velocity in (
        ("intro", 0.8),
        ("chorus", 0.8),
        ("bridge", 1.0),
        ("chorus2", 1.0),
        ("outro", 1.0),
    ):
        chords = held_chords(_chords(section), FORM.start(section), 4.0, 63.0, velocity)
        stem.play(instruments.choir, chords, 0.6)
    stem.play(instruments.choir, held_chords(["Em"], FORM.beats, 2.5, 60.0, 1.0), 0.8)
    stem.play(instruments.choir, phrase(CHORUS, FORM.start("chorus2"), 0.5, -12))
    return stem.samples


def _leads(desk: Desk) -> F64:
    stem = desk.stem()
    stem.play(instruments.soft_lead, phrase(VERSE, FORM.start("verse"), 0.55, -12))
    stem.play(instruments.brass, phrase(CHORUS, FORM.start("chorus"), 0.75))
    stem.play(instruments.brass, phrase(CHORUS, FORM.start("chorus2"), 0.75))
    stem.play(instruments.brass, phrase(CHORUS, FORM.start("chorus2"), 0.5, -12))
    stem.play(instruments.theremin, phrase(DIES_IRAE, FORM.start("bridge"), 0.55, 0, gate=0.98))
    stem.play(instruments.theremin, phrase("E5/1.5 D#5/.5 E5!/2", FORM.start("intro", 2), 0.6))
    stem.play(
        instruments.theremin,
        phrase("G5/1 F#5/1 G5/1 E5/1 | F#5/1 D#5/1 E5!/3", FORM.start("outro"), 0.8),
    )
    return stem.samples


def _keys(desk: Desk) -> F64:
    stem = desk.stem()
    stem.play(instruments.organ, held_chords(_chords("intro"), 0.0, 4.0, 57.0, 0.7))
    stem.play(instruments.organ, _stabs("verse", 62.0, 0.7))
    for section in ("chorus", "chorus2"):
        stem.play(instruments.organ, _stabs(section, 66.0, 0.8))
        stem.play(
            instruments.organ, held_chords(_chords(section), FORM.start(section), 4.0, 55.0, 0.3)
        )
    stem.play(
        instruments.organ, held_chords(_chords("bridge"), FORM.start("bridge"), 4.0, 52.0, 0.7)
    )
    stem.play(instruments.organ, held_chords(_chords("outro"), FORM.start("outro"), 4.0, 57.0, 0.8))
    lane = [(0, 500), (16, 3_000), (48, 5_000), (80, 1_200), (104, 2_500), (105, 7_000), (144, 900)]
    return swept_lowpass(stem.samples, desk.curve(lane, per_sample=False))


def play(desk: Desk) -> F32:
    """Return the piece, (n,) at 44.1 kHz, played on `desk`."""
    bass = desk.stem()
    for section in ("verse", "chorus", "chorus2"):
        bass.play(instruments.slap_bass, _bass(section), loose_s=0.002)
    slow = [
        Note(FORM.start(section, bar), 3.8, root(symbol, 40.0), 0.7)
        for section in ("bridge", "outro")
        for bar, symbol in enumerate(_chords(section))
    ]
    bass.play(instruments.electric_bass, [*slow, Note(FORM.beats, 4.0, 40, 0.8)])
    guitar = desk.stem()
    for section in ("verse", "chorus", "chorus2"):
        guitar.play(instruments.muted_guitar, _scratch(section))
    leads = _leads(desk)
    desk.mix(_drums(desk), 0.5, -16.0)
    desk.mix(bass.samples, -4.0)
    desk.mix(highpass(guitar.samples, 250.0), -3.5, -14.0)
    desk.mix(highpass(_keys(desk), 150.0), -5.0, -12.0)
    desk.mix(_choir(desk), -5.0, -6.0)
    desk.mix(leads + 0.4 * echo(leads, 0.75 * desk.beat_s, 0.3), -8.0, -8.0)
    desk.mix(_atmosphere(desk), -3.0, -6.0)
    return desk.master(room(2.4, seed=3, brightness_hz=4_000.0))
