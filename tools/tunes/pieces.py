"""The four bundled pieces. Every bar draws small variations, so that no passage is a copy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from downbeat.perception.features import F32
from downbeat.tools.tunes.mix import Song, chord

Bars = Sequence[tuple[int, str, int]]


@dataclass(frozen=True)
class Piece:
    """A piece of music.

    Attributes:
        name, title: For the catalogue.
        tempo_bpm: Tempo; beat 0 stands at 0 s.
        beats_per_bar: Beats of a bar.
        sections: (name, bars).
        compose: Returns the samples, 44.1 kHz mono.
    """

    name: str
    title: str
    tempo_bpm: float
    beats_per_bar: int
    sections: tuple[tuple[str, int], ...]
    compose: Callable[[Piece], F32]

    @property
    def bars(self) -> int:
        """Length in bars."""
        return sum(count for _, count in self.sections)

    def sections_s(self) -> list[tuple[str, float, float]]:
        """Return (name, start_s, end_s) of the sections."""
        bar_s = self.beats_per_bar * 60.0 / self.tempo_bpm
        rows, bar = [], 0
        for name, count in self.sections:
            rows.append((name, bar * bar_s, (bar + count) * bar_s))
            bar += count
        return rows

    def song(self, seed: int) -> Song:
        """Return an empty song of this piece's length."""
        return Song(self.tempo_bpm, self.bars * self.beats_per_bar, seed)

    def walk(self) -> list[tuple[int, str, int]]:
        """Return (bar, section name, bar inside the section)."""
        rows, bar = [], 0
        for name, count in self.sections:
            for inside in range(count):
                rows.append((bar, name, inside))
                bar += 1
        return rows

    def fills(self, song: Song) -> None:
        """Play a drum fill before every section but the first."""
        bar = 0
        for _, count in self.sections[:-1]:
            bar += count
            song.fill(bar * self.beats_per_bar)


def _phrase(
    song: Song, pitches: Sequence[int], rhythm: Sequence[tuple[float, float]], last: int
) -> list[tuple[float, float, float]]:
    """Draw a melodic phrase: chord tones on the rhythm, moving by small steps."""
    steps = []
    for beat, beats in rhythm:
        near = sorted(pitches, key=lambda p: (abs(p - last), p))[:4]
        weights = [0.15, 0.35, 0.3, 0.2][: len(near)]
        total = sum(weights)
        last = int(song.rng.choice(near, p=[w / total for w in weights]))
        steps.append((beat, beats, float(last)))
    return steps


def _spread(pitches: Sequence[int], low: int, high: int) -> list[int]:
    """Return a chord's pitch classes over a range."""
    classes = {p % 12 for p in pitches}
    return [p for p in range(low, high) if p % 12 in classes]


def neon_parade(piece: Piece) -> F32:
    """Synth-pop: four on the floor, pumping pads, a saw lead that sings in the chorus."""
    song = piece.song(11)
    changes = {
        "intro": ("Am", "F", "C", "G"),
        "verse": ("Am", "F", "C", "Em"),
        "chorus": ("F", "G", "Am", "C"),
        "bridge": ("Dm", "Am", "Bb", "E7"),
        "outro": ("Am", "F", "C", "G"),
    }
    rhythms = (
        ((0, 0.75), (0.75, 0.75), (1.5, 1.0), (2.5, 0.5), (3, 1.0)),
        ((0, 1.5), (1.5, 0.5), (2, 0.5), (2.5, 0.5), (3, 0.5), (3.5, 0.5)),
    )
    last = 76
    for bar, name, inside in piece.walk():
        at, pitches = 4.0 * bar, chord(changes[name][inside % 4])
        full = name in ("chorus", "outro")
        for beat in range(4):
            if name != "bridge" or inside >= 4:
                song.hit("kick", at + beat)
            song.hit("hat", at + beat + 0.5, 0.9 if full else 0.6)
            if name != "intro" and beat % 2:
                song.hit("clap", at + beat, 0.9)
        song.chord("pad", [p - 12 for p in pitches] + [pitches[1]], at, 4.0)
        for step in range(8):
            octave = 12 if step % 2 and name != "verse" else 0
            song.note("bass", pitches[0] - 24 + octave, at + step * 0.5, 0.42)
        if name in ("intro", "verse", "bridge"):
            order = song.rng.permutation(len(pitches))
            for step in range(8):
                pitch = pitches[int(order[step % len(order)])] + (12 if step > 3 else 0)
                song.note("pluck", pitch + 12, at + step * 0.5, 0.4, 0.8)
        if name in ("chorus", "outro") or (name == "verse" and inside % 2):
            rhythm = rhythms[int(song.rng.integers(2))]
            phrase = _phrase(song, _spread(pitches, 69, 89), rhythm, last)
            last = int(phrase[-1][2])
            song.melody("saw_lead", phrase, at, 1.0 if full else 0.7)
    piece.fills(song)
    return song.mix(
        reverb={"pad": 0.5, "saw_lead": 0.45, "pluck": 0.4, "drums": 0.08},
        duck={"pad": 0.75, "bass": 0.5, "saw_lead": 0.25},
        delay={"pluck": 0.35, "saw_lead": 0.22},
    )


def salsa_del_puerto(piece: Piece) -> F32:
    """Salsa: clave, montuno, tumbao, congas, and a brass section in the coro."""
    song = piece.song(22)
    changes = {
        "intro": ("Am7", "D7", "G", "E7"),
        "verse": ("Am7", "Dm7", "E7", "Am7"),
        "chorus": ("Dm7", "G7", "C", "E7"),
        "mambo": ("Am7", "G7", "F", "E7"),
        "outro": ("Am7", "Dm7", "E7", "Am7"),
    }
    last = 72
    for bar, name, inside in piece.walk():
        at, pitches = 4.0 * bar, chord(changes[name][inside % 4])
        clave = (0.0, 1.5, 3.0) if bar % 2 == 0 else (1.0, 2.0)
        for beat in clave:
            song.hit("clave", at + beat, 0.8)
        for step in range(8):
            kind = ("conga_slap", "conga_low", "conga_slap", "conga_high")[step % 4]
            if song.rng.random() < 0.9 or step >= 6:
                song.hit("conga_high" if step in (6, 7) else kind, at + step * 0.5, 0.7)
            song.hit("shaker", at + step * 0.5, 0.8 if step % 2 else 0.5)
        for beat in range(4):
            song.hit("cowbell" if name in ("chorus", "mambo") else "hat", at + beat, 0.6)
        song.hit("kick", at, 0.5)
        song.note("upright", pitches[0] - 24, at, 1.2)
        song.note("upright", pitches[2] - 24, at + 1.5, 1.2)
        song.note("upright", pitches[0] - 12 if inside % 2 else pitches[0] - 24, at + 3.0, 0.9)
        montuno = (0.0, 0.5, 1.0, 1.5, 2.5, 3.0, 3.5)
        for index, beat in enumerate(montuno):
            if song.rng.random() < 0.12:
                continue
            pitch = pitches[(index + inside) % len(pitches)]
            song.chord("piano", (pitch, pitch + 12), at + beat, 0.4, 0.8)
        if name in ("chorus", "mambo"):
            stabs = ((0.5, 0.4), (1.5, 0.4), (2.5, 0.9)) if inside % 2 else ((0, 1.4), (2.5, 1.0))
            for beat, beats in stabs:
                song.chord("brass", [p + 12 for p in pitches[:3]], at + beat, beats, 0.9)
        if name in ("verse", "outro", "mambo"):
            rhythm = ((0, 0.5), (0.5, 1.0), (1.5, 0.5), (2, 0.5), (2.5, 1.0), (3.5, 0.5))
            phrase = _phrase(song, _spread(pitches, 65, 86), rhythm, last)
            last = int(phrase[-1][2])
            song.melody("flute" if name == "verse" else "brass", phrase, at, 0.8)
    piece.fills(song)
    return song.mix(
        reverb={"brass": 0.35, "piano": 0.25, "flute": 0.4, "drums": 0.12}, duck={}, delay={}
    )


def midnight_bones(piece: Piece) -> F32:
    """Horror funk in C minor: slapped bass, organ, cowbell, a choir that rises."""
    song = piece.song(33)
    changes = {
        "intro": ("Cm7", "Cm7", "Ab", "G7"),
        "verse": ("Cm7", "Fm7", "Cm7", "G7"),
        "chorus": ("Ab", "Bb", "Cm7", "G7"),
        "bridge": ("Fm7", "Db", "Cm7", "G7"),
        "outro": ("Cm7", "Ab", "Fm7", "G7"),
    }
    riffs = (
        ((0, 0), (0.75, 0), (1.5, 12), (2, 10), (2.75, 7), (3.5, 3)),
        ((0, 0), (0.5, 12), (1.25, 0), (2, 3), (2.5, 5), (3.25, 7)),
        ((0, 0), (0.75, 10), (1.5, 12), (2.25, 0), (3, 7), (3.5, 10)),
    )
    last = 74
    for bar, name, inside in piece.walk():
        at, pitches = 4.0 * bar, chord(changes[name][inside % 4])
        song.hit("kick", at)
        song.hit("kick", at + (2.5 if inside % 2 else 2.25), 0.9)
        song.hit("kick", at + 1.5, 0.6)
        if name != "intro":
            song.hit("snare", at + 1)
            song.hit("snare", at + 3)
        for step in range(8):
            song.hit("open_hat" if step == 7 else "hat", at + step * 0.5, 0.8 if step % 2 else 0.5)
        if name in ("chorus", "outro"):
            for beat in range(4):
                song.hit("cowbell", at + beat, 0.7)
        for beat, step in riffs[int(song.rng.integers(3))]:
            song.note("slap", pitches[0] - 24 + step, at + beat, 0.45)
        for beat in (0.5, 1.75, 2.5, 3.5):
            if song.rng.random() < 0.8:
                song.chord("organ", pitches, at + beat, 0.3, 0.9)
        if name in ("intro", "chorus", "bridge"):
            song.chord("choir", [p + (12 if name == "bridge" else 0) for p in pitches], at, 4.0)
        if name in ("verse", "chorus", "outro"):
            rhythm = ((0.5, 0.5), (1, 0.75), (1.75, 0.75), (2.5, 0.5), (3, 1.0))
            phrase = _phrase(song, _spread(pitches, 67, 87), rhythm, last)
            last = int(phrase[-1][2])
            song.melody("saw_lead" if name != "verse" else "bell", phrase, at, 0.9)
    piece.fills(song)
    return song.mix(
        reverb={"choir": 0.7, "bell": 0.6, "organ": 0.2, "saw_lead": 0.4, "drums": 0.1},
        duck={"choir": 0.3},
        delay={"bell": 0.4},
    )


def tide_runner(piece: Piece) -> F32:
    """Trance at 140: an arpeggio that never rests, offbeat bass, risers into the drops."""
    song = piece.song(44)
    changes = {
        "intro": ("Em", "C", "G", "D"),
        "build": ("Em", "C", "Am", "B7"),
        "drop": ("Em", "G", "D", "C"),
        "break": ("C", "D", "Bm", "Em"),
        "outro": ("Em", "C", "G", "D"),
    }
    last = 79
    for bar, name, inside in piece.walk():
        at, pitches = 4.0 * bar, chord(changes[name][inside % 4])
        ladder = _spread(pitches, 64, 90)
        start = int(song.rng.integers(0, 4))
        for step in range(16):
            if name == "break" and step % 2:
                continue
            position = (start + (step if step < 8 else 16 - step)) % len(ladder)
            song.note("pluck", ladder[position], at + step * 0.25, 0.24, 0.75)
        if name != "break":
            for beat in range(4):
                song.hit("kick", at + beat)
                song.note("bass", pitches[0] - 24, at + beat + 0.5, 0.42)
                song.hit("open_hat", at + beat + 0.5, 0.7)
            if name in ("drop", "outro"):
                song.hit("clap", at + 1, 0.8)
                song.hit("clap", at + 3, 0.8)
        song.chord("pad", [p - 12 for p in pitches], at, 4.0, 1.2 if name == "break" else 0.8)
        if name in ("drop", "break"):
            rhythm = ((0, 1.0), (1, 0.5), (1.5, 1.0), (2.5, 0.5), (3, 1.0))
            phrase = _phrase(song, ladder, rhythm, last)
            last = int(phrase[-1][2])
            song.melody("saw_lead" if name == "drop" else "bell", phrase, at, 0.9)
        if name == "build" and inside % 8 >= 6:
            for step in range(8):
                song.hit("snare", at + step * 0.5, 0.3 + 0.05 * step)
    bar = 0
    for _, count in piece.sections[:-1]:
        bar += count
        song.hit("riser", 4.0 * bar - 4.4, 0.9)
        song.hit("crash", 4.0 * bar, 0.9)
    return song.mix(
        reverb={"pad": 0.5, "pluck": 0.35, "saw_lead": 0.45, "bell": 0.6},
        duck={"pad": 0.8, "pluck": 0.35, "bass": 0.2, "saw_lead": 0.3},
        delay={"pluck": 0.3, "bell": 0.35},
    )


_ALL = (
    Piece(
        "neon_parade",
        "Neon Parade",
        128.0,
        4,
        (("intro", 6), ("verse", 6), ("chorus", 8), ("verse", 6), ("chorus", 8), ("outro", 4)),
        neon_parade,
    ),
    Piece(
        "salsa_del_puerto",
        "Salsa del Puerto",
        98.0,
        4,
        (("intro", 4), ("verse", 6), ("chorus", 6), ("mambo", 4), ("chorus", 6), ("outro", 4)),
        salsa_del_puerto,
    ),
    Piece(
        "midnight_bones",
        "Midnight Bones",
        116.0,
        4,
        (("intro", 6), ("verse", 6), ("chorus", 6), ("bridge", 6), ("chorus", 6), ("outro", 5)),
        midnight_bones,
    ),
    Piece(
        "tide_runner",
        "Tide Runner",
        140.0,
        4,
        (("intro", 6), ("build", 8), ("drop", 8), ("break", 6), ("build", 6), ("drop", 8)),
        tide_runner,
    ),
)

PIECES = {piece.name: piece for piece in _ALL}
"""The bundled pieces by name."""
