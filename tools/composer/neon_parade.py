"""Neon Parade: synth-pop in A minor, 128 BPM. Supersaws, pumping pads, four on the floor."""

from __future__ import annotations

from downbeat.perception.features import F32
from downbeat.tools.composer import instruments, percussion
from downbeat.tools.composer.desk import Desk
from downbeat.tools.composer.effects import ducking, echo, highpass, room, swept_lowpass
from downbeat.tools.composer.form import Form
from downbeat.tools.composer.score import (
    Note,
    grid_hits,
    held_chords,
    phrase,
    root,
    transposed,
    voicing,
)
from downbeat.tools.composer.waves import F64

FORM = Form(
    "neon_parade",
    "Neon Parade",
    128.0,
    (("intro", 4), ("verse", 8), ("chorus", 8), ("bridge", 8), ("chorus2", 8), ("outro", 4)),
    tail_s=1.5,
)

CHORDS = {
    "intro": "Am F C G",
    "verse": "Am F C G Am F C E7",
    "chorus": "F G Am C F G E7 Am",
    "bridge": "Dm Am Bb F Dm Am Bb E7",
    "chorus2": "F G Am C F G E7 Am",
    "outro": "F G Am Am",
}
VERSE = (
    "A4/.5 C5/.5 E5!/1 D5/.5 C5/.5 A4/1 | -/.5 A4/.5 C5/.5 D5/.5 C5!/1 -/1 |"
    "G4/.5 C5/.5 E5!/1 D5/.5 E5/.5 G5/1 | D5/1.5 B4/.5 D5/1 -/1 |"
    "A4/.5 C5/.5 E5!/1 G5/.5 E5/.5 D5/1 | C5/.5 D5/.5 C5/.5 A4/.5 C5/1 -/1 |"
    "E5!/.75 D5/.25 C5/.5 E5/.5 G5/1 E5/1 | G#4/.5 B4/.5 D5/.5 E5/.5 B4!/2"
)
CHORUS = (
    "C6!/.75 A5/.75 F5/.5 G5/.5 A5/1.5 | B5!/.75 G5/.75 D5/.5 E5/.5 G5/1.5 |"
    "A5!/.75 E5/.75 C5/.5 D5/.5 E5/1 G5/.5 | G5/1.5 E5/.5 -/.5 C5/.5 D5/.5 E5/.5 |"
    "A5!/.75 C6/.75 A5/.5 G5/.5 F5/1.5 | G5!/.75 B5/.75 D6/.5 B5/.5 G5/1.5 |"
    "G#5!/.75 B5/.75 E6/.5 D6/.5 B5/.5 G#5/1 | A5!/2.5 -/.5 E5/.5 G5/.5"
)
HARMONY = (
    "A5/.75 F5/.75 C5/.5 E5/.5 F5/1.5 | G5/.75 D5/.75 B4/.5 C5/.5 D5/1.5 |"
    "E5/.75 C5/.75 A4/.5 B4/.5 C5/1 E5/.5 | E5/1.5 C5/.5 -/.5 G4/.5 B4/.5 C5/.5 |"
    "F5/.75 A5/.75 F5/.5 E5/.5 C5/1.5 | D5/.75 G5/.75 B5/.5 G5/.5 D5/1.5 |"
    "E5/.75 G#5/.75 B5/.5 B5/.5 G#5/.5 E5/1 | E5/2.5 -/1.5"
)
BRIDGE = (
    "-/1 F5/1 E5/.5 D5/1.5 | C5/2 E5!/1 A5/1 | -/1 D5/.5 F5/.5 A#5!/1 A5/1 | A5/1.5 G5/.5 F5/2 |"
    "-/.5 D5/.5 F5/.5 A5/.5 D6!/2 | C6/1 A5/1 E5/2 | F5/.5 A#5/.5 D6!/1 C6/.5 A#5/.5 A5/1 |"
    "G#5/.5 B5/.5 E5/.5 G#5/.5 B5!/2"
)


def _chords(section: str) -> list[str]:
    return CHORDS[section].split()


def _bar_chords() -> list[tuple[float, str]]:
    """Return (beat, chord) of every bar."""
    rows = []
    for section, _ in FORM.sections:
        rows += [(FORM.start(section, bar), symbol) for bar, symbol in enumerate(_chords(section))]
    return rows


def _arpeggio(section: str, pattern: tuple[int, ...], velocity: float) -> list[Note]:
    """Run through each bar's chord in sixteenths; the pattern turns by one every bar."""
    notes = []
    for bar, symbol in enumerate(_chords(section)):
        tones = voicing(symbol, 70.0)
        tones = tones + [tone + 12 for tone in tones]
        for step in range(16):
            index = pattern[(step + bar) % len(pattern)]
            accent = 1.0 if step % 4 == 0 else 0.7
            beat = FORM.start(section, bar) + step / 4
            notes.append(Note(beat, 0.24, tones[index % len(tones)], velocity * accent))
    return notes


def _bass(section: str, offbeat: bool) -> list[Note]:
    notes = []
    for bar, symbol in enumerate(_chords(section)):
        low = root(symbol, 36.0)
        for eighth in range(8):
            beat = FORM.start(section, bar) + eighth / 2
            if offbeat and eighth % 2 == 0:
                continue
            octave = 12 if eighth in (3, 6) and not offbeat else 0
            pitch = low + octave
            if eighth == 7 and bar % 2 == 1:
                pitch = low + 7
            notes.append(Note(beat, 0.42, pitch, 1.0 if eighth % 2 else 0.85))
    return notes


def _kick_beats() -> list[float]:
    beats = []
    for section in ("verse", "chorus", "chorus2"):
        first = FORM.start(section)
        beats += [first + beat for beat in range(FORM.bars(section) * 4)]
    beats += [FORM.start("intro", 2) + beat for beat in range(8)]
    beats += [FORM.start("bridge", 4) + beat for beat in range(0, 16, 2)]
    beats += [FORM.start("outro") + beat for beat in range(12)]
    return sorted(set(beats))


def _drums(desk: Desk) -> tuple[F64, F64]:
    """Return (kick, the rest)."""
    kick = desk.stem().hit(percussion.kick, [(beat, 1.0) for beat in _kick_beats()])
    kit = desk.stem()
    for section in ("verse", "chorus", "chorus2"):
        for bar in range(FORM.bars(section)):
            beat = FORM.start(section, bar)
            is_loud = section != "verse"
            kit.hit(percussion.clap, grid_hits("....x.......x...", beat), 0.9 if is_loud else 0.65)
            hats = "x.o.x.oox.o.x.oo" if bar % 2 == 0 else "x.o.x.o.xoo.x.ox"
            kit.hit(percussion.hat, grid_hits(hats, beat), 0.32)
            if is_loud:
                kit.hit(
                    percussion.open_hat,
                    grid_hits("..x...x...x...x.", beat),
                    0.42,
                )
                kit.hit(percussion.snare, grid_hits("....x.......x..o", beat), 0.4)
    for bar in range(4):
        kit.hit(percussion.hat, grid_hits("..o...o...o..oo.", FORM.start("outro", bar)), 0.3)
    _fills(desk, kit)
    return kick.samples, kit.samples


def _fills(desk: Desk, kit: object) -> None:
    """Announce every section: a fill before it, a crash on it."""
    for section in ("verse", "chorus", "bridge", "chorus2", "outro"):
        beat = FORM.start(section)
        kit.hit(percussion.crash, [(beat, 1.0)], 0.5)
        kit.hit(percussion.snare, grid_hits("x.xxxxXX", beat - 2), 0.5)
        kit.hit(percussion.tom_high, grid_hits("x.x.....", beat - 2), 0.5)
        kit.hit(percussion.tom_low, grid_hits("....x.x.", beat - 2), 0.55)
    for bar, pattern in ((6, "x...x...x...x..."), (7, "x.x.x.x.xxxxXXXX")):
        kit.hit(percussion.snare, grid_hits(pattern, FORM.start("bridge", bar)), 0.42)
    for section, bars in (("verse", 2), ("chorus", 2), ("chorus2", 4)):
        wind = percussion.riser(bars * 4 * desk.beat_s, bars)
        kit.sound(wind, FORM.start(section) - 4 * bars, 0.35)


def _pads(desk: Desk) -> F64:
    stem = desk.stem()
    for section, velocity in (
        ("intro", 1.0),
        ("verse", 0.6),
        ("chorus", 1.0),
        ("bridge", 1.0),
        ("chorus2", 1.1),
        ("outro", 1.0),
    ):
        chords = held_chords(_chords(section), FORM.start(section), 4.0, 64.0, velocity)
        stem.play(instruments.pad, chords, 0.5)
    lane = [(0, 350), (16, 2_500), (16.5, 1_100), (46, 1_900), (48, 6_500), (79, 7_500), (80, 900)]
    lane += [(110, 5_500), (112, 8_000), (144, 9_000), (160, 500)]
    return swept_lowpass(stem.samples, desk.curve(lane, per_sample=False))


def _arpeggios(desk: Desk) -> F64:
    stem = desk.stem()
    stem.play(instruments.pluck, _arpeggio("intro", (0, 2, 1, 3, 2, 4), 0.8))
    stem.play(instruments.pluck, _arpeggio("verse", (0, 1, 2, 3, 4, 2, 1), 0.55))
    stem.play(instruments.pluck, _arpeggio("chorus", (0, 3, 1, 4, 2), 0.5))
    stem.play(instruments.pluck, _arpeggio("bridge", (0, 2, 4, 5, 3, 1), 0.45))
    stem.play(instruments.pluck, _arpeggio("chorus2", (5, 3, 4, 1, 2, 0, 3), 0.6))
    stem.play(instruments.pluck, _arpeggio("outro", (0, 2, 1, 3, 2, 4), 0.7))
    lane = [(0, 500), (16, 4_000), (48, 2_500), (80, 5_000), (112, 7_000), (144, 6_000), (160, 400)]
    dry = swept_lowpass(stem.samples, desk.curve(lane, per_sample=False))
    return dry + echo(dry, 0.75 * desk.beat_s, 0.38)


def _leads(desk: Desk) -> tuple[F64, F64]:
    """Return (verse and bridge voice, chorus lead)."""
    voice = desk.stem().play(instruments.soft_lead, phrase(VERSE, FORM.start("verse"), 0.8))
    voice.play(instruments.bell, phrase(BRIDGE, FORM.start("bridge"), 0.8))
    voice.play(instruments.soft_lead, phrase(BRIDGE, FORM.start("bridge"), 0.4, -12))
    last = "A5/1.5 G5/.5 E5/2 | D5/1 E5/1 G5/2 | A5!/4"
    voice.play(instruments.bell, phrase(last, FORM.start("outro"), 0.8))
    lead = desk.stem().play(instruments.super_lead, phrase(CHORUS, FORM.start("chorus"), 0.85))
    second = FORM.start("chorus2")
    lead.play(instruments.super_lead, phrase(CHORUS, second, 0.8))
    lead.play(instruments.super_lead, phrase(HARMONY, second, 0.6))
    lead.play(instruments.bell, transposed(phrase(CHORUS, second, 0.3), 12))
    lead.play(instruments.super_lead, held_chords(["Am"], FORM.start("outro", 3), 4.0, 69.0, 0.5))
    sung = voice.samples + 0.7 * echo(voice.samples, 0.75 * desk.beat_s, 0.35)
    return sung, lead.samples + 0.5 * echo(lead.samples, 0.5 * desk.beat_s, 0.3)


def play(desk: Desk) -> F32:
    """Return the piece, (n,) at 44.1 kHz, played on `desk`."""
    kick, kit = _drums(desk)
    kicks_s = [desk.time_s(beat) for beat in _kick_beats() if desk.has(beat)]
    pump = ducking(desk.length, kicks_s, 0.75, 0.8 * desk.beat_s)
    bass = desk.stem().play(instruments.synth_bass, _bass("verse", offbeat=True), loose_s=0.001)
    for section in ("chorus", "chorus2"):
        bass.play(instruments.synth_bass, _bass(section, offbeat=False), loose_s=0.001)
    roots = [Note(beat, 3.9, root(symbol, 38.0), 0.4) for beat, symbol in _bar_chords()]
    bass.play(instruments.synth_bass, [n for n in roots if 80 <= n.beat < 112 or n.beat >= 144])
    voice, lead = _leads(desk)
    desk.mix(kick, -3.0)
    desk.mix(kit, 0.0, -16.0)
    desk.mix(bass.samples * (0.4 + 0.6 * pump), 4.0)
    desk.mix(highpass(_pads(desk), 180.0) * pump, -4.0, -8.0)
    desk.mix(_arpeggios(desk) * (0.5 + 0.5 * pump), -4.0, -9.0)
    desk.mix(voice, -11.5, -8.0)
    desk.mix(lead * (0.7 + 0.3 * pump), -4.5, -10.0)
    return desk.master(room(1.9, seed=1))
