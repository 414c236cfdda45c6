"""Networks of words as chains of phone states between hubs, and the best paths through them.

A chain is one pronunciation of a word or of a whole phrase; it leads from a hub to a hub. All
chains of a network advance together, one array operation per frame, whatever their number; per
chain the search knows at every frame how well it ends there and where it began, so that the scores
of all phrases are known after one pass, not only the winner's.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from downbeat.perception.acoustic_model import STATES, AcousticModel
from downbeat.perception.features import F32

NEVER = np.float32(-1e9)
_START, _SKIP = -1, -2


class Columns:
    """Which senones a search reads; where several fit, as at a word's edge, the best counts."""

    def __init__(self, model: AcousticModel) -> None:
        self.model = model
        self._sets: dict[tuple[int, ...], int] = {}

    def column(self, senones: Iterable[int]) -> int:
        """Return the column of the best of some senones."""
        key = tuple(sorted(set(senones)))
        return self._sets.setdefault(key, len(self._sets))

    def select(self, likelihoods: F32) -> F32:
        """Return (t, columns) of (t, s) log-likelihoods of all senones."""
        found = np.empty((len(likelihoods), len(self._sets)), np.float32)
        for senones, column in self._sets.items():
            if len(senones) == 1:
                found[:, column] = likelihoods[:, senones[0]]
            else:
                likelihoods[:, senones].max(axis=1, out=found[:, column])
        return found

    def chain(
        self, words: Sequence[Sequence[int]], lefts: Sequence[int], rights: Sequence[int]
    ) -> tuple[list[int], list[int]]:
        """Return the columns and the phones of the states of some words spoken without a pause.

        Args:
            words: Of each word its phones.
            lefts: Phones that may come before.
            rights: Phones that may follow.
        """
        flat = [(phone, place(at, len(word))) for word in words for at, phone in enumerate(word)]
        columns: list[int] = []
        for at, (phone, where) in enumerate(flat):
            before = [flat[at - 1][0]] if at else lefts
            after = [flat[at + 1][0]] if at + 1 < len(flat) else rights
            fit = [self.model.senones(phone, b, a, where) for b in before for a in after]
            columns += [self.column(states[k] for states in fit) for k in range(STATES)]
        return columns, [phone for phone, _ in flat for _ in range(STATES)]

    def any_context(self) -> list[list[int]]:
        """Return, of every phone, the columns of its states between whatever others."""
        return [[self.column(senones) for senones in phone] for phone in self.model.all_senones()]


def place(at: int, length: int) -> str:
    """Return where in a word of so many phones one stands, as the triphones name it."""
    if length == 1:
        return "single"
    return "begin" if at == 0 else "end" if at == length - 1 else "inside"


@dataclass(frozen=True)
class Chain:
    """One pronunciation between two hubs.

    Attributes:
        columns: One per state.
        phones: The phone of each state.
        entry: Hub that it leaves.
        leads_to: Hub that it leads to.
        weight: Logarithm of its probability among what leaves the hub.
        label: What it says; "" for silence.
    """

    columns: Sequence[int]
    phones: Sequence[int]
    entry: int
    leads_to: int
    weight: float
    label: str


@dataclass(frozen=True)
class Part:
    """A chain on a path: what it says, its first frame and the one after its last."""

    label: str
    first: int
    end: int


class Network:
    """Chains between hubs, compiled for `search`; hub 0 is the beginning."""

    def __init__(
        self,
        model: AcousticModel,
        chains: Sequence[Chain],
        skips: Sequence[tuple[int, int]] = (),
        is_reversed: bool = False,
    ) -> None:
        """Compile.

        Args:
            model: Of the transitions.
            chains: All of them.
            skips: Pairs of hubs that also follow each other with nothing between; in order.
            is_reversed: It is searched from the last frame to the first.
        """
        self.chains = list(chains)
        self.skips = list(skips)
        self.is_reversed = is_reversed
        order = -1 if is_reversed else 1
        sizes = np.array([len(chain.columns) for chain in chains])
        self.first = np.concatenate(([0], np.cumsum(sizes)[:-1]))
        self.last = self.first + sizes - 1
        self.columns = np.concatenate([chain.columns[::order] for chain in chains])
        phones = np.concatenate([chain.phones[::order] for chain in chains])
        states = np.concatenate([np.arange(size)[::order] % STATES for size in sizes])
        self.stay = model.stay[phones, states]
        self.leave = model.leave[phones, states]
        self.entry = np.array([chain.entry for chain in chains])
        self.weight = np.array([chain.weight for chain in chains], np.float32)
        leads_to = np.array([chain.leads_to for chain in chains])
        self.hubs = int(max(self.entry.max(), leads_to.max(), *(b for _, b in self.skips), 0)) + 1
        self.arriving = [
            (hub, np.flatnonzero(leads_to == hub)) for hub in sorted(set(leads_to.tolist()))
        ]


@dataclass(frozen=True)
class Search:
    """The best paths through a network; frame t of `hubs` is before frame t of the sound.

    Attributes:
        network: What was searched.
        hubs: (t + 1, hubs) log score of the best path that stands in a hub.
        ends: (t, chains) of the best path that ends a chain with this frame.
        begins: (t, chains) frame at which it began the chain.
        came_by: (t + 1, hubs) chain, or skip, by which the best path came into a hub.
    """

    network: Network
    hubs: F32
    ends: F32
    begins: NDArray[np.int32]
    came_by: NDArray[np.int32]

    def path(self, frame: int, hub: int) -> list[Part]:
        """Return what the best path said that stands in a hub before a frame."""
        found: list[Part] = []
        while (by := int(self.came_by[frame, hub])) != _START:
            if by <= _SKIP:
                hub = _SKIP - by
                continue
            begin = int(self.begins[frame - 1, by])
            chain = self.network.chains[by]
            found.append(Part(chain.label, begin, frame))
            frame, hub = begin, chain.entry
        return found[::-1]


def search(network: Network, scores: F32) -> Search:
    """Find the best paths (Viterbi).

    Args:
        network: To go through.
        scores: (t, columns) log-likelihoods; for a reversed network the last frame first.
    """
    count = len(scores)
    emitted = scores[:, network.columns]
    old = np.full(len(network.columns), NEVER)
    born = np.zeros(len(old), np.int32)
    hubs = np.full((count + 1, network.hubs), NEVER)
    came_by = np.full((count + 1, network.hubs), _START, np.int32)
    ends = np.empty((count, len(network.chains)), np.float32)
    begins = np.empty(ends.shape, np.int32)
    hubs[0, 0] = 0.0
    moved, moved_born = np.empty_like(old), np.empty_like(born)
    for frame in range(count):
        _skip(network, hubs[frame], came_by[frame])
        np.add(old[:-1], network.leave[:-1], out=moved[1:])
        moved_born[1:] = born[:-1]
        moved[network.first] = hubs[frame, network.entry] + network.weight
        moved_born[network.first] = frame
        stayed = old + network.stay
        goes = moved > stayed
        old = np.where(goes, moved, stayed) + emitted[frame]
        born = np.where(goes, moved_born, born)
        ends[frame] = old[network.last] + network.leave[network.last]
        begins[frame] = born[network.last]
        for hub, chains in network.arriving:
            by = chains[ends[frame, chains].argmax()]
            hubs[frame + 1, hub] = ends[frame, by]
            came_by[frame + 1, hub] = by
    _skip(network, hubs[count], came_by[count])
    return Search(network, hubs, ends, begins, came_by)


def _skip(network: Network, hubs: F32, came_by: NDArray[np.int32]) -> None:
    for begin, end in network.skips:
        if hubs[begin] > hubs[end]:
            hubs[end] = hubs[begin]
            came_by[end] = _SKIP - begin


def best_states(scores: F32, stay: F32, leave: F32) -> NDArray[np.int64]:
    """Return the state of every frame if one chain says the whole sound.

    Args:
        scores: (t, states) log-likelihoods of the chain's states, in their order.
        stay: (states,) logarithm of staying.
        leave: (states,) of going on.

    Returns:
        (t,) rising from the first state to the last.
    """
    count, states = scores.shape
    old = np.full(states, NEVER)
    old[0] = scores[0, 0]
    goes = np.zeros((count, states), bool)
    moved = np.full(states, NEVER)
    for frame in range(1, count):
        moved[1:] = old[:-1] + leave[:-1]
        stayed = old + stay
        goes[frame] = moved > stayed
        old = np.where(goes[frame], moved, stayed) + scores[frame]
    found = np.empty(count, np.int64)
    state = states - 1
    for frame in range(count - 1, -1, -1):
        found[frame] = state
        state -= int(goes[frame, state])
    return found


def combinations(forms: Sequence[Sequence[str]], most: int) -> list[list[str]]:
    """Return ways to say some words in a row: one form of each, the usual ones first."""
    return [list(one) for one in itertools.islice(itertools.product(*forms), most)]
