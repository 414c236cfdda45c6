"""The listener itself on short clips and on hours of foreign sound: locks, and false ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from downbeat.lcm_types import music_match_t
from downbeat.perception.features import F32
from downbeat.perception.matcher import AlignmentMatcher, MatchResult
from downbeat.perception.source import Recording
from downbeat.tools.chunks_make import Query, is_silent
from downbeat.tools.chunks_score import ConditionScore
from downbeat.tools.conditions import Degradation, pink, reverb, speed
from downbeat.tools.matcher_cuts import Heard, listen

CLIP_S, END_S = 10.0, 1.0
"""Clips whose last part is silent are not asked."""
PART_S = (4.0, 12.0)
"""A foreign stream is made of parts of this length."""
LEVEL = 0.1
"""RMS of each part."""

HEARD_S = 5.0
"""So much before a lock is compared with its track, or what there was of the sound."""

Judge = Callable[[Query, MatchResult, ConditionScore], bool]
SameSound = Callable[[Query, MatchResult], bool]


@dataclass
class Cost:
    """Processor time of the listener [s], and the sound that it heard [s]."""

    spent_s: float = 0.0
    heard_s: float = 0.0

    def add(self, spent_s: float, sound: Recording) -> None:
        """Add one recording."""
        self.spent_s += spent_s
        self.heard_s += sound.duration_s

    @property
    def share(self) -> float:
        """Of one core, in real time."""
        return self.spent_s / max(self.heard_s, 1e-9)


@dataclass
class StreamScore:
    """What the listener made of clips.

    Attributes:
        n: Clips.
        right: Locked on the right track at the right place when the clip ends.
        held: As `right`, or in doubt at that moment, with the place still known.
        wrong: Locked elsewhere then.
        ended: Not among them: the music is over before the clip is, and a lock would be wrong.
        lock_s: From the start of a clip to the first lock on its track [s]; inf: none.
    """

    n: int = 0
    right: int = 0
    held: int = 0
    wrong: int = 0
    ended: int = 0
    lock_s: list[float] = field(default_factory=list)

    def shares(self) -> dict[str, Any]:
        """Return shares, and quantiles of the time to the first lock; None: no lock so often."""
        waits = np.sort(self.lock_s)
        p50, p95 = (_quantile(waits, share) for share in (0.5, 0.95))
        count = max(self.n, 1)
        return {
            "n": self.n,
            "right": round(self.right / count, 4),
            "held": round(self.held / count, 4),
            "wrong": round(self.wrong / count, 4),
            "ended": self.ended,
            "first_lock_s": {"p50": p50, "p95": p95},
        }


def _quantile(waits: np.ndarray, share: float) -> float | None:
    """Return a quantile of sorted times, (n,); None where one that it needs is infinite."""
    needed = waits[: int(np.ceil(share * (len(waits) - 1))) + 1]
    if len(needed) == 0 or not np.isfinite(needed[-1]):
        return None
    finite = np.where(np.isfinite(waits), waits, needed[-1])
    return round(float(np.quantile(finite, share)), 2)


def clips(
    recording: Recording, degradation: Degradation, count: int, seed: int, score: StreamScore
) -> Iterator[tuple[float, Recording]]:
    """Cut clips anywhere in a track, (start [s], clip), and count those that end in silence."""
    room_s = recording.duration_s - CLIP_S
    rng = np.random.default_rng([seed, len(recording.samples)])
    for _ in range(count if room_s > 0.0 else 0):
        rate = recording.sample_rate_hz
        first = round(float(rng.uniform(0.0, room_s)) * rate)
        part = recording.samples[first : first + round(CLIP_S * rate)]
        heard = degradation.apply(part, rate, rng)
        if is_silent(part[-round(END_S * rate) :]):
            score.ended += 1
            continue
        yield first / rate, Recording(recording.name, heard, rate)


def hear_clip(
    matcher: AlignmentMatcher,
    start_s: float,
    clip: Recording,
    judge: Judge,
    score: StreamScore,
    cost: Cost,
) -> None:
    """Let the listener hear a clip from a cold start and count what it says at the end."""
    heard, spent_s = listen(matcher, clip)
    cost.add(spent_s, clip)
    locked = [h for h in heard if h.lock == music_match_t.LOCKED]
    first = next((h.time_s for h in locked if h.track == clip.name), float("inf"))
    score.n += 1
    score.lock_s.append(first)
    if not heard or not heard[-1].track:
        return
    is_right = judge_end(heard[-1], start_s, clip, judge)
    is_locked = heard[-1].lock == music_match_t.LOCKED
    score.held += is_right
    score.right += is_right and is_locked
    score.wrong += is_locked and not is_right


def judge_end(last: Heard, start_s: float, clip: Recording, judge: Judge) -> bool:
    """Say whether the lock at the end of a clip stands where the music stood, 5 s before."""
    back_s = 5.0
    at_s = last.time_s - back_s
    query = Query("", clip.name, start_s + at_s, 0.0, clip.samples, False)
    place = MatchResult(track=last.track, tau_s=at_s - last.track_zero_s, accepted=True)
    return judge(query, place, ConditionScore())


@dataclass(frozen=True, slots=True)
class Part:
    """One sound in a foreign stream.

    Attributes:
        start_s: Where it begins in the stream [s].
        name: Of the sound.
        from_s: Where in the sound it begins [s].
        factor: How much faster it is played.
    """

    start_s: float
    name: str
    from_s: float
    factor: float

    def at(self, at_s: float) -> float:
        """Return where in the sound it is at a second of the stream [s]."""
        return self.from_s + (at_s - self.start_s) * self.factor


@dataclass(frozen=True)
class ForeignStream:
    """Sound on which nobody may lock, and what it is made of, in order."""

    sound: Recording
    parts: Sequence[Part]

    def part_at(self, at_s: float) -> Part:
        """Return what plays at a second of the stream."""
        return next(p for p in reversed(self.parts) if p.start_s <= at_s or p is self.parts[0])

    def playing(self, at_s: float) -> str:
        """Say what plays at a second of the stream: "NAME at SECOND", both of the sound's own."""
        part = self.part_at(at_s)
        return f"{part.name} at {part.at(at_s):.1f} s"


@dataclass
class LockCount:
    """Locks taken on sound that the catalogue lacks, as text: what played, taken for what.

    Attributes:
        seconds: Sound heard [s].
        locks: False ones.
        elsewhere: Not among them: taken for a track that holds the identical recording there.
    """

    seconds: float = 0.0
    locks: list[str] = field(default_factory=list)
    elsewhere: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Return counts and names."""
        return {
            "minutes": round(self.seconds / 60.0, 1),
            "locks": len(self.locks),
            "which": self.locks,
            "same_recording_elsewhere": len(self.elsewhere),
            "elsewhere": self.elsewhere,
        }


def foreign_stream(sounds: Sequence[Recording], seconds: float, seed: int) -> ForeignStream:
    """Return parts of sounds in any order, each faster or slower, in noise or in a room.

    Args:
        sounds: All at one rate.
        seconds: Length of the result.
        seed: Of everything drawn.
    """
    rng = np.random.default_rng(seed)
    rate = sounds[0].sample_rate_hz
    made: list[F32] = []
    parts: list[Part] = []
    done, wanted = 0, round(seconds * rate)
    while done < wanted:
        source = sounds[int(rng.integers(len(sounds)))]
        count = min(round(float(rng.uniform(*PART_S)) * rate), len(source.samples))
        first = int(rng.integers(len(source.samples) - count + 1))
        factor = float(rng.uniform(0.85, 1.2))
        part = speed(factor)(source.samples[first : first + count], rate, rng)
        what = int(rng.integers(3))
        if what == 1:
            part = pink(float(rng.uniform(5.0, 20.0)))(part, rate, rng)
        elif what == 2:
            part = reverb(float(rng.uniform(0.2, 1.0)), 0.0)(part, rate, rng)
        part = part * np.float32(LEVEL / max(float(np.sqrt(np.mean(part**2))), 1e-4))
        made.append(part[: wanted - done])
        parts.append(Part(done / rate, source.name, first / rate, factor))
        done += len(made[-1])
    return ForeignStream(Recording("foreign", np.concatenate(made), rate), parts)


def count_locks(
    matcher: AlignmentMatcher,
    stream: ForeignStream,
    is_same_sound: SameSound,
    count: LockCount,
    cost: Cost,
) -> None:
    """Count every lock that the listener takes on a stream.

    What was heard before counts as well: a lock early in a part may be owed to the one before.
    """
    heard, spent_s = listen(matcher, stream.sound)
    cost.add(spent_s, stream.sound)
    count.seconds += stream.sound.duration_s
    before = ""
    for hop in heard:
        now = hop.track if hop.lock == music_match_t.LOCKED else ""
        if now not in ("", before):
            is_same = _is_of_same_sound(hop, stream.part_at(hop.time_s), is_same_sound)
            which = count.elsewhere if is_same else count.locks
            which.append(f"{stream.playing(hop.time_s)} taken for {now}")
        before = now


def _is_of_same_sound(hop: Heard, part: Part, is_same_sound: SameSound) -> bool:
    """Compare what a lock has heard of a part with what its track holds there."""
    playing_s = part.at(hop.time_s)
    back_s = min(HEARD_S, playing_s - part.from_s)
    query = Query("", part.name, playing_s - back_s, 0.0, np.zeros(0, np.float32), False)
    tau_s = hop.time_s - hop.track_zero_s - back_s
    return is_same_sound(query, MatchResult(track=hop.track, tau_s=tau_s, accepted=True))
