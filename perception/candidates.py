"""Where a query may lie: every place is compared, or an inverted index proposes some."""

from __future__ import annotations

from downbeat.perception.alignment import CoarseScan, FineAligner
from downbeat.perception.index import Index, coarse_of_fine, make_decoys, power_of_fine


def prepare(index: Index) -> tuple[CoarseScan, FineAligner]:
    """Return both stages of the search over an index, with its decoys."""
    decoys = make_decoys(index.fine)
    scan = CoarseScan([*index.coarse, *(coarse_of_fine(d) for d in decoys)])
    power = [*index.power, *(power_of_fine(d) for d in decoys)]
    return scan, FineAligner([*index.fine, *decoys], power)
