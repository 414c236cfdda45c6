"""The parts of the listener and the conductor, as hearing.toml wants them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from downbeat.perception.chunk_tracker import ChunkTracker
from downbeat.perception.errors import PerceptionError
from downbeat.perception.hearing_config import HearingConfig
from downbeat.perception.tracker import Tracker
from downbeat.perception.unknown_ear import UnknownEar


def build_matcher(config: HearingConfig, index: Path) -> Any:
    """Load the matcher.

    Raises:
        PerceptionError: The index is missing, foreign, old or damaged.
    """
    if config.matcher == "constellation":
        from downbeat.perception.constellation import ConstellationMatcher

        return ConstellationMatcher.load(index)
    from downbeat.perception.matcher import AlignmentMatcher

    return AlignmentMatcher.load(index)


def build_tracker(config: HearingConfig, matcher: Any) -> Tracker | ChunkTracker:
    """Return what follows the track."""
    return ChunkTracker(matcher) if config.conductor.mode == "chunks" else Tracker(matcher)


def build_router(config: HearingConfig, folder: Path) -> Any:
    """Load the router.

    Args:
        config: Which.
        folder: What a relative model file is relative to.

    Raises:
        PerceptionError: Its model cannot be loaded.
    """
    choice = config.router
    if choice.backend == "energy":
        from downbeat.perception.router_energy import EnergyRouter

        return EnergyRouter(choice.thresholds)
    from downbeat.perception.router_choice import make_router

    model = folder / choice.model if choice.model else None
    return make_router(choice.backend, model, choice.thresholds)


def build_unknown(config: HearingConfig, folder: Path, index: Path) -> UnknownEar | None:
    """Build what listens to music that the catalogue lacks; None if nobody wants it.

    Args:
        config: What is wanted.
        folder: What a relative model folder is relative to.
        index: Of the catalogue: the likeness table lies beside it.

    Raises:
        PerceptionError: A model or the table is damaged.
    """
    if config.conductor.unknown == "ignore":
        return None
    from downbeat.perception.beat_follower import BeatFollower
    from downbeat.perception.section_finder import SectionFinder

    finder = SectionFinder() if config.sections else None
    return UnknownEar(BeatFollower(), finder, build_likeness(config, folder, index))


def build_likeness(config: HearingConfig, folder: Path, index: Path) -> Any:
    """Load what finds the most similar track; None: nothing does.

    Raises:
        PerceptionError: A model or the table is damaged, or made by another embedder.
    """
    choice = config.likeness
    if choice.backend == "none":
        return None
    from downbeat.perception.likeness_build import LIKENESS_NAME, load_likeness

    table = index.with_name(LIKENESS_NAME)
    if choice.backend == "clap":
        from downbeat.perception.clap_model import ClapEmbedder

        return load_likeness(table, ClapEmbedder(folder / choice.model))
    if not table.is_file():
        return None  # a catalogue of before: any of its dances fits unknown music as well
    return load_likeness(table)


def build_conductor(
    config: HearingConfig, timeline: Any, tracks: Any, skills: Any, **voice: Any
) -> Any:
    """Build the conductor's logic.

    Args:
        config: Mode, gates, habits.
        timeline: What the tracks ask for.
        tracks: The catalogue.
        skills: By name.
        voice: `allowed` and `hold_s` of speech, where the show has it.

    Raises:
        PerceptionError: The paper's mode in a show that listens to words.
    """
    if config.conductor.mode == "chunks":
        from downbeat.perception.chunk_conductor import ChunkConductor

        if voice:
            raise PerceptionError(
                "conductor.mode = 'chunks' hears no words; a show with speech needs 'predict' "
                "(hearing.toml:conductor.mode)."
            )
        return ChunkConductor(tracks, skills, config.conductor)
    from downbeat.perception.conductor import Conductor
    from downbeat.perception.improviser import Improviser

    improviser = Improviser(tracks, skills)
    return Conductor(timeline, skills, config=config.conductor, improviser=improviser, **voice)
