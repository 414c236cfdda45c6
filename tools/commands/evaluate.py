"""`downbeat eval`: the paper's experiments on any tracks and skills."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Mashup:
    """Cut a folder of recordings into a mashup, dance it, print the metrics."""

    tracks: Path
    """Folder of audio files (wav, flac, ogg, mp3); each is indexed alone, the mashup never."""
    section_seconds: float = 20.0
    """Length of each section [s]; shorter tracks are left out and named."""
    seed: int = 0
    """Chooses tracks, cuts, skills and the plant's noise."""
    announced: bool = False
    """Give the set list to the conductor."""
    sections: int = 8
    """How many sections at most."""
    rules: Path | None = None
    """Folder of track files with timed rules (as in catalog/tracks) instead of assigned skills."""
    realtime: bool = False
    """Separate processes over LCM in real time, instead of lockstep."""
    video: bool = False
    """Render video.mp4 after the run."""
    runs: Path = Path("runs")
    """Where runs are kept; `latest` points to the newest."""
    url: str = ""
    """LCM URL for --realtime."""
    imported: Path | None = None
    """Folder of imported policies (downbeat policy import) that may be played besides."""
    fallback: str = ""
    """The skill that catches a fall."""
    transitions: Literal["proven", "rules", "via_stand", "hard"] = "proven"
    """How skills change: as the atlas and the checker prove, or, to compare with, by the measured
    rules alone, always through stand, or at once and without a blend."""
    checker: bool = True
    """Simulate plans before they are made."""
    atlas: Path | None = None
    """Folder of proven changes (downbeat sweep); default: the bundled one."""
    perturb: bool = True
    """Draw the plant's mass (+-5 %) and friction (0.5 to 0.8) by the seed."""
    hearing: Path | None = None
    """hearing.toml: matcher, router, gates, or the paper's way to listen (docs/hearing.md)."""
    json: bool = False
    """Print metrics as one JSON object on standard output."""

    def run(self) -> int:
        """Run it; 0 if the robot stayed up and followed every section."""
        from downbeat.tools.eval_mashup import run_eval_mashup

        return run_eval_mashup(self)


@dataclass(frozen=True)
class Beat:
    """Dance a generated piece for two minutes and print the beat-phase error."""

    bpm: tuple[float, ...] = (98.0, 128.0, 140.0)
    """Tempos to play."""
    seconds: float = 120.0
    """Length of each run [s]."""
    skill: str = "kpop"
    """Dance to play."""
    seed: int = 0
    """Seed of the plant's noise."""
    runs: Path = Path("runs")
    """Where runs are kept."""
    json: bool = False
    """Print rows as one JSON object on standard output."""

    def run(self) -> int:
        """Run it; 0 if every p95 is within 20 ms."""
        from downbeat.tools.eval_beat import run_eval_beat

        return run_eval_beat(self)


@dataclass(frozen=True)
class Follow:
    """Follow the beat of recordings nobody knows while they play, against offline analyses."""

    tracks: Path | None = None
    """Folder of audio files (wav, flac, ogg, mp3); omitted: the bundled pieces."""
    robot: Path | None = None
    """Folder of voices: hear through the robot's microphone among them."""
    start_s: float = 0.0
    """Begin this far into every recording [s]."""
    json: bool = False
    """Print the report as one JSON object on standard output."""

    def run(self) -> int:
        """Run it; 0 if the phase errors reach their targets."""
        from downbeat.tools.eval_follow import run_eval_follow

        return run_eval_follow(self.tracks, self.robot, self.start_s, self.json)


@dataclass(frozen=True)
class Speech:
    """Ground written utterances, or with --spoken: speak to the robot and see what it does."""

    spoken: bool = False
    """Speak 21 commands and 20 other sentences with espeak-ng, and let them be heard and obeyed in
    lockstep."""
    noise: tuple[Literal["clean", "20", "10"], ...] = ("clean", "20", "10")
    """spoken: signal over noise [dB]."""
    voices: int = 3
    """spoken: how many voices."""
    seed: int = 0
    """spoken: order of the sentences, noise."""
    keep: bool = False
    """spoken: keep logs and sounds of the runs."""
    runs: Path = Path("runs")
    """spoken: where runs are kept."""

    utterances: Path | None = None
    """Tab-separated set of your own: half, kind, expected, text; omitted: the bundled one."""
    half: Literal["tune", "test", "all"] = "test"
    """Thresholds were found on `tune`; `test` was written by someone else and never tuned on."""
    letters_only: bool = False
    """Without the sentence model."""
    json: bool = False
    """Print the score as one JSON object on standard output."""

    def run(self) -> int:
        """Run it; 0 if commands, false triggers and negations reach their targets."""
        if self.spoken:
            from downbeat.tools.eval_spoken import eval_spoken

            return eval_spoken(self.runs, self.noise, self.voices, self.seed, self.json, self.keep)
        from downbeat.tools.eval_speech import eval_speech

        return eval_speech(self.utterances, self.half, self.letters_only, self.json)


@dataclass(frozen=True)
class Chunks:
    """Recognise single windows of a folder of recordings, degraded in many ways, and strangers."""

    tracks: Path | None = None
    """Folder of audio files (wav, flac, ogg, mp3); omitted: the bundled pieces."""
    speech: Path | None = None
    """Folder of voices: babble, the robot's microphone, and sound that must be refused."""
    other: Path | None = None
    """Folder of other sounds that must be refused."""
    groups: Path | None = None
    """Tab-separated file (track, group): same composer or sample bank, counted as a class."""
    per_shift: int = 6
    """Clean chunks per track and shift."""
    per_condition: int = 6
    """Chunks per track and condition."""
    seed: int = 7
    """Of all noise."""
    only: tuple[str, ...] = ()
    """These conditions only."""
    paper: bool = False
    """The paper's experiment instead: the policy of each chunk's section, at least 574 chunks."""
    clips: int = 0
    """Let the listener hear so many clips of 10 s per track, too."""
    foreign_minutes: float = 0.0
    """And so many minutes of foreign music, and of speech and noise."""
    json: bool = False
    """Print the report as one JSON object on standard output; shares are 0..1."""

    def run(self) -> int:
        """Run it; 0."""
        from downbeat.tools.eval_chunks import ChunkOptions, eval_chunks

        return eval_chunks(
            ChunkOptions(
                self.tracks, self.speech, self.other, self.groups,
                self.per_shift, self.per_condition, self.seed, self.only,
                self.paper, self.clips, 60.0 * self.foreign_minutes,
            ),
            self.json,
        )  # fmt: skip


@dataclass(frozen=True)
class Sections:
    """Hear the cuts of mashups without knowing any of their tracks."""

    tracks: Path
    """Folder of audio files (wav, flac, ogg, mp3); what cannot be read or has under 31 s is left
    out, named."""
    section_seconds: tuple[float, ...] = (20.0, 30.0)
    """Lengths of sections [s], 6 or more; for each, shorter recordings are left out, named."""
    mashups: int = 20
    """Mashups of six sections for each length."""
    seed: int = 0
    """Chooses tracks, passages and levels."""
    fade_seconds: float = 0.0
    """Over which a section fades into the next [s]; 0: a hard cut."""
    json: bool = False
    """Print the score as one JSON object on standard output."""

    def run(self) -> int:
        """Run it; 0."""
        from downbeat.tools.eval_sections import eval_sections

        return eval_sections(
            self.tracks,
            self.section_seconds,
            self.mashups,
            self.seed,
            self.json,
            self.fade_seconds,
        )


@dataclass(frozen=True)
class Router:
    """Tell windows of music, songs, speech, speech over music, and other sounds apart."""

    music: Path | None = None
    """Folder of music."""
    songs: Path | None = None
    """Folder of music with singing, a class of its own."""
    speech: Path | None = None
    """Folder of voices; they are heard over the music, too."""
    other: Path | None = None
    """Folder of sounds that are neither."""
    model: Path | None = None
    """What `downbeat models export ast` wrote; omitted: the embedded router."""
    per_source: int = 12
    """Windows of 5 s per recording at most."""
    seed: int = 7
    """Of rooms and mixtures."""
    json: bool = False
    """Print the table as one JSON object on standard output; shares are 0..1."""

    def run(self) -> int:
        """Run it; 0."""
        from downbeat.tools.eval_router import RouterOptions, eval_router

        options = RouterOptions(
            self.music, self.songs, self.speech, self.other, self.model, self.per_source, self.seed
        )
        return eval_router(options, self.json)


@dataclass(frozen=True)
class Likeness:
    """Ask for music that the catalogue has not: is the most similar track of the same group?"""

    tracks: Path
    """Folder of audio files (wav, flac, ogg, mp3); each in turn is taken out of the catalogue."""
    groups: Path
    """Tab-separated file (track, group): same game, composer or sample bank."""
    seconds: float = 5.0
    """Length of a query [s]; at least 5."""
    condition: str = "clean"
    """What is done to queries, as in `eval chunks`."""
    speech: Path | None = None
    """Folder of voices, for the conditions with babble and for `robot`."""
    clap: Path | None = None
    """Folder of an exported CLAP instead of the embedded descriptor."""
    seed: int = 0
    """Of noise and bootstrap."""
    json: bool = False
    """Print the report as one JSON object on standard output; shares are 0..1."""

    def run(self) -> int:
        """Run it; 0."""
        from downbeat.tools.eval_likeness import LikenessOptions, eval_likeness

        return eval_likeness(
            LikenessOptions(
                self.tracks, self.groups, self.seconds, self.condition, self.speech, self.clap,
                self.seed,
            ),
            self.json,
        )  # fmt: skip


@dataclass(frozen=True)
class Unknown:
    """Dance to recordings that the catalogue lacks, by the whole chain; how far off the beat?"""

    tracks: Path
    """Folder of recordings that are the catalogue."""
    strangers: Path
    """Folder of other recordings; those with a steady beat are played."""
    seconds: float = 40.0
    """Of each stranger, from anywhere in it [s]."""
    count: int = 20
    """Strangers at most."""
    seed: int = 0
    """Chooses strangers, passages and the plant's noise."""
    runs: Path = Path("runs")
    """Where runs are kept."""
    json: bool = False
    """Print the score as one JSON object on standard output."""

    def run(self) -> int:
        """Run it; 0 if nobody fell."""
        from downbeat.tools.eval_unknown import eval_unknown

        return eval_unknown(
            self.tracks, self.strangers, self.seconds, self.count, self.seed, self.runs, self.json
        )


@dataclass(frozen=True)
class Eval:
    """Evaluate known music (`mashup`, `chunks`, `beat`), unknown music, the router and speech."""

    what: (
        Annotated[Mashup, tyro.conf.subcommand("mashup")]
        | Annotated[Chunks, tyro.conf.subcommand("chunks")]
        | Annotated[Sections, tyro.conf.subcommand("sections")]
        | Annotated[Unknown, tyro.conf.subcommand("unknown")]
        | Annotated[Beat, tyro.conf.subcommand("beat")]
        | Annotated[Follow, tyro.conf.subcommand("follow")]
        | Annotated[Speech, tyro.conf.subcommand("speech")]
        | Annotated[Likeness, tyro.conf.subcommand("likeness")]
        | Annotated[Router, tyro.conf.subcommand("router")]
    )

    def run(self) -> int:
        """Run the chosen evaluation."""
        return self.what.run()
