"""The rule by which an online check refuses a plan that the atlas has proven.

The atlas says "at most p of the robots fall, whatever the night"; the check says "f of N fell from
here". A lone fall among 32 is what a proven plan may well show, so a plan is refused only when its
falls contradict the atlas: when a plan at the atlas' very bound would show as many in fewer than
`FALSE_VETO` of the checks. With a bound of 1 % and 32 rollouts that is 3 falls (chance 0.4 %),
with 0.3 % it is 2 (0.4 %).
"""

from __future__ import annotations

FALSE_VETO = 0.005
"""Share of checks of a plan exactly at its bound that may refuse it by bad luck."""


def chance_of_at_least(fallen: int, count: int, p: float) -> float:
    """Return the chance of `fallen` or more falls among `count` when each falls with `p`."""
    if fallen <= 0:
        return 1.0
    below, term = 0.0, (1.0 - p) ** count
    for k in range(fallen):
        below += term
        term *= (count - k) / (k + 1) * p / (1.0 - p)
    return max(1.0 - below, 0.0)


def is_refused(bound: float, fallen: int, count: int) -> bool:
    """Whether an online check contradicts the atlas.

    Args:
        bound: The plan's upper bound in the atlas.
        fallen: Rollouts that fell.
        count: Rollouts that were done in time.
    """
    if fallen == 0:
        return False
    return chance_of_at_least(fallen, count, min(bound, 0.5)) < FALSE_VETO
