"""A show: which files and settings its processes share, and how each process is built."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from downbeat.catalog.setlist import load_setlist
from downbeat.catalog.tracks import Track, load_tracks
from downbeat.control.atlas import BUNDLED_ATLAS, Atlas
from downbeat.control.blackbox import BlackBox
from downbeat.control.core import ControlCore, CoreConfig, TickInput, TickOutput
from downbeat.control.node import ControlNode
from downbeat.control.policy import SkillLibrary
from downbeat.control.prover import ProofConfig
from downbeat.policies.manifest import SkillManifest, load_skills
from downbeat.runtime.bus import Bus
from downbeat.runtime.config import load_config, plain
from downbeat.tools.errors import ToolError

SHOW_NAME = "show.toml"
TRANSITIONS = ("proven", "rules", "via_stand", "hard")


@dataclass(frozen=True)
class ShowConfig:
    """Content of show.toml; paths are relative to its folder.

    Attributes:
        audio: The sound file; or "mic:", "mic:NAME", "robot:INTERFACE", "chunks:"
            (perception/source_spec.py).
        tracks: Folder of track files.
        index: Fingerprint index.
        set_list: Set list of an announced show, empty: cuts are a surprise.
        skills: Folder of skills, empty: the bundled ones.
        imported: Folder of further skills, as `downbeat policy import` writes them.
        fallback: The skill that catches a fall; empty: the best of our own.
        control_cpu: Processor that control keeps to, -1: any.
        seed: Of the plant's noise.
        sensor_noise: Whether the plant's sensors are noisy.
        command_delay_us: From a command to its effect on the motors [us].
        mass_scale: Factor on the plant's torso mass.
        friction: Of the plant's soles and floor.
        atlas: Folder of proven changes; empty: the bundled one.
        transitions: "proven"; "rules" (without an atlas), "via_stand" or "hard" to compare with.
        checker: Whether a checker process simulates plans before they are made.
        speech: The speech process's speech.toml; empty: nobody listens to words.
        hearing: How music is heard and followed, hearing.toml; empty: the defaults.
    """

    audio: str
    tracks: str
    index: str
    set_list: str = ""
    skills: str = ""
    imported: str = ""
    fallback: str = ""
    control_cpu: int = -1
    seed: int = 0
    sensor_noise: bool = True
    command_delay_us: int = 4_000
    mass_scale: float = 1.0
    friction: float = 0.6
    atlas: str = ""
    transitions: str = "proven"
    checker: bool = True
    speech: str = ""
    hearing: str = ""

    def to_toml(self) -> str:
        """Return the show as TOML."""
        return "".join(f"{key} = {json.dumps(value)}\n" for key, value in plain(self).items())


@dataclass(frozen=True)
class Show:
    """A show file and where it lies."""

    config: ShowConfig
    folder: Path

    def path(self, name: str) -> Path:
        """Return a file of the show."""
        return self.folder / name


def load_show(path: Path) -> Show:
    """Read show.toml.

    Raises:
        DownbeatError: Missing, not TOML, an unknown key or a wrong type (file:key).
    """
    return Show(load_config(path, ShowConfig), path.parent)


def skills_folder(show: Show) -> Path | None:
    """Return the folder of skills, None for the bundled ones."""
    return show.path(show.config.skills) if show.config.skills else None


def show_tracks(show: Show) -> dict[str, Track]:
    """Return the show's tracks, with every rule's skill checked."""
    return load_tracks(show.path(show.config.tracks), show_skills(show))


def show_skills(show: Show) -> dict[str, SkillManifest]:
    """Return the manifests of everything the show may play."""
    manifests = load_skills(skills_folder(show))
    if show.config.imported:
        manifests.update(load_skills(show.path(show.config.imported)))
    return manifests


def make_sim(show: Show, bus: Bus) -> Any:
    """Build the plant process."""
    from downbeat.sim.node import SimNode
    from downbeat.sim.noise import NO_NOISE, NoiseConfig
    from downbeat.sim.plant import PlantConfig

    noise = NoiseConfig() if show.config.sensor_noise else NO_NOISE
    settings = show.config
    config = PlantConfig(
        noise=noise,
        seed=settings.seed,
        command_delay_us=settings.command_delay_us,
        mass_scale=settings.mass_scale,
        friction=settings.friction,
    )
    return SimNode(bus, config)


def make_listener(show: Show, bus: Bus, first_sample_utime: int) -> Any:
    """Build the listener process; its file starts to sound at `first_sample_utime`.

    Raises:
        DownbeatError: The sound, the index or a track cannot be used.
    """
    from downbeat.perception.listener import ListenerNode
    from downbeat.perception.source_spec import CHUNKS, open_source
    from downbeat.tools import hearing_parts as parts

    tracks = show_tracks(show)

    def next_boundary_s(track: str, tau_s: float) -> float | None:
        return tracks[track].next_change_s(tau_s) if track in tracks else None

    hearing = show_hearing(show)
    index = show.path(show.config.index)
    matcher = parts.build_matcher(hearing, index)
    audio = show.config.audio
    source = open_source(audio, show.folder, bus, first_sample_utime)
    # Chunks of another process are on the bus already.
    shares = bool(show.config.speech) and audio != CHUNKS
    return ListenerNode(
        bus,
        source,
        matcher,
        next_boundary_s,
        parts.build_router(hearing, show.folder),
        shares,
        parts.build_unknown(hearing, show.folder, index),
        parts.build_tracker(hearing, matcher),
    )


def show_hearing(show: Show) -> Any:
    """Return the show's HearingConfig.

    Raises:
        DownbeatError: hearing.toml is missing, or something in it is wrong (file:key).
    """
    from downbeat.perception.hearing_config import HearingConfig

    if not show.config.hearing:
        return HearingConfig()
    return load_config(show.path(show.config.hearing), HearingConfig)


def make_conductor(show: Show, bus: Bus) -> Any:
    """Build the conductor process."""
    from downbeat.perception.conductor_node import ConductorNode
    from downbeat.perception.timeline import Timeline
    from downbeat.tools.hearing_parts import build_conductor

    tracks = show_tracks(show)
    set_list = (
        load_setlist(show.path(show.config.set_list), tracks) if show.config.set_list else None
    )
    speech = show_speech(show)
    voice: dict[str, Any] = {}
    if speech is not None:
        allowed = frozenset(speech.skills) if speech.skills else None
        voice = {"allowed": allowed, "hold_s": speech.hold_s}
    conductor = build_conductor(
        show_hearing(show), Timeline(tracks, set_list), tracks, show_skills(show), **voice
    )
    return ConductorNode(bus, conductor, frozenset(tracks))


def show_speech(show: Show) -> Any:
    """Return the show's SpeechConfig, None if nobody listens to words.

    Raises:
        DownbeatError: speech.toml is missing, or something in it is wrong (file:key).
    """
    if not show.config.speech:
        return None
    from downbeat.perception.speech_config import SpeechConfig

    config = load_config(show.path(show.config.speech), SpeechConfig)
    config.check(show_skills(show))
    return config


def make_speech(
    show: Show,
    bus: Bus,
    first_utime: int,
    is_simulated_time: bool,
    say: Callable[[str], None] | None = None,
) -> Any:
    """Build the speech process; None if the show has none.

    Args:
        show: The show.
        bus: Endpoint of the process.
        first_utime: Time of the first sample of spoken.wav [us].
        is_simulated_time: Work at once instead of in a thread.
        say: Told in one line what the process hears and does, once that is loaded.
    """
    from downbeat.tools.speech_parts import build_speech

    config = show_speech(show)
    if config is None:
        return None
    titles = {name: track.title for name, track in show_tracks(show).items()}
    skills = show_skills(show)
    return build_speech(
        config, skills, bus, show.folder, first_utime, is_simulated_time, titles, say
    )


def make_core(show: Show) -> ControlCore:
    """Load the skills and build control's core.

    Raises:
        DownbeatError: A skill cannot be loaded.
    """
    settings = show.config
    imported = show.path(settings.imported) if settings.imported else None
    library = SkillLibrary.load(skills_folder(show), imported=imported)
    config = CoreConfig(fallback=settings.fallback, proof=show_proof(show))
    return ControlCore(library, config, show_atlas(show))


def show_proof(show: Show) -> ProofConfig:
    """Return how sure a change of skill must be.

    Raises:
        ToolError: `transitions` is none of the valid words.
    """
    settings = show.config
    if settings.transitions not in TRANSITIONS:
        raise ToolError(
            f"transitions = '{settings.transitions}' is not possible; valid are "
            f"{', '.join(TRANSITIONS)} ({show.folder / SHOW_NAME}:transitions)."
        )
    if settings.transitions in ("via_stand", "hard"):
        return ProofConfig(policy=cast(Any, settings.transitions))
    return ProofConfig(use_checker=settings.checker)


def show_atlas(show: Show) -> Atlas | None:
    """Return the atlas of a show, None if the measured rules alone shall decide.

    Raises:
        DownbeatError: The folder does not hold an atlas.
    """
    settings = show.config
    folder = show.path(settings.atlas) if settings.atlas else BUNDLED_ATLAS
    if settings.transitions != "proven" or not (settings.atlas or folder.exists()):
        return None
    return Atlas.load(folder, show_skills(show))


def has_checker(show: Show) -> bool:
    """Whether the show has a checker process."""
    settings = show.config
    wanted = settings.checker and settings.transitions == "proven"
    return wanted and (bool(settings.atlas) or BUNDLED_ATLAS.exists())


def make_checker(show: Show, bus: Bus, is_simulated_time: bool, engine: str = "native") -> Any:
    """Build the checker process; None if the show has none."""
    atlas = show_atlas(show)
    if atlas is None or not show.config.checker:
        return None
    from downbeat.sim.checker import Checker, CheckerNode

    checker = Checker(show_skills(show), atlas, show_proof(show), engine=cast(Any, engine))
    return CheckerNode(bus, checker, is_simulated_time)


def make_control(
    show: Show,
    bus: Bus,
    journal: Callable[[TickInput, TickOutput], None] | None = None,
    timing: Callable[[], tuple[int, int, int]] | None = None,
    core: ControlCore | None = None,
) -> ControlNode:
    """Build the control process, around `core` if one is loaded already."""
    blackbox = BlackBox(show.path("blackbox"), bus.clock)
    return ControlNode(bus, core or make_core(show), journal, timing, blackbox)
