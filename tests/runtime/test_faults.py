"""Fault tables: valid or refused; hysteresis tick by tick."""

from dataclasses import replace
from enum import IntEnum

import pytest

from downbeat.runtime.faults import Fault, FaultMonitor, FaultTable, FaultTableError


class Reaction(IntEnum):
    NONE = 0
    STOP = 1


LATE = Fault(2, "late", Reaction.NONE, "Late by {} us.", raise_after_ticks=3, clear_after_ticks=2)
DEAD = Fault(1, "dead", Reaction.STOP, "Dead.", latched=True)


@pytest.mark.parametrize(
    "change",
    [
        {"id": 0},
        {"id": 2**15},
        {"name": "Late Comer"},
        {"raise_after_ticks": 0},
        {"clear_after_ticks": 0},
        {"message": "{} and {}."},
        {"message": "{value}."},
        {"message": "no sentence"},
    ],
)
def test_wrong_row_is_refused(change):
    with pytest.raises(FaultTableError, match="Fault"):
        FaultTable([replace(LATE, **change)])


@pytest.mark.parametrize("change", [{"id": 1}, {"name": "dead"}])
def test_id_and_name_are_unique(change):
    with pytest.raises(FaultTableError, match="twice"):
        FaultTable([DEAD, replace(LATE, **change)])


def test_rows_are_found_by_name_and_id_hardest_first():
    table = FaultTable([LATE, DEAD])
    assert table.names == ("dead", "late") and len(table) == 2
    assert table.named("late") is LATE and table.with_id(1) is DEAD
    with pytest.raises(FaultTableError, match="dead, late"):
        table.named("nothing")
    with pytest.raises(FaultTableError, match="no fault 9"):
        table.with_id(9)


def test_fault_rises_and_clears_after_its_ticks():
    monitor = FaultMonitor(FaultTable([LATE, DEAD]))
    script = [1, 1, 0, 1, 1, 1, 0, 1, 0, 0]
    active = [bool(monitor.update(["late"] if on else [])) for on in script]
    assert active == [False, False, False, False, False, True, True, True, True, False]


def test_latched_fault_stays_until_cleared_and_its_condition_is_gone():
    monitor = FaultMonitor(FaultTable([LATE, DEAD]))
    monitor.update(["dead"])
    monitor.clear_latched()
    assert monitor.active == (DEAD,)
    assert monitor.update([]) == (DEAD,)
    monitor.clear_latched()
    assert monitor.active == ()
    with pytest.raises(FaultTableError):
        monitor.update(["unknown"])
