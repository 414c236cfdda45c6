"""The router without a model: silence is SKIP, everything else is taken for music."""

from __future__ import annotations

import math

import numpy as np

from downbeat.perception.features import F32
from downbeat.perception.router import MUSIC, SAMPLE_RATE_HZ, SKIP, RouterConfig, Verdict

LEVEL_S = 1.0


class EnergyRouter:
    """Leaves it to the matcher to refuse what is no music."""

    name = "energy"

    def __init__(self, config: RouterConfig | None = None) -> None:
        """Begin; `config`: its silence level counts."""
        self._silence_dbfs = (config or RouterConfig()).silence_dbfs
        self.reset()

    def hear(self, samples: F32, first_utime: int) -> None:
        """Take in a block, (n,) at 16 kHz."""
        count = round(LEVEL_S * SAMPLE_RATE_HZ)
        self._newest = np.concatenate([self._newest, samples])[-count:]

    def reset(self) -> None:
        """Forget everything heard."""
        self._newest = np.zeros(0, np.float32)

    def judge(self, evidence: float) -> Verdict:
        """Return MUSIC, or SKIP below the silence level; there is no evidence against it."""
        power = float(np.var(self._newest, dtype=np.float64)) if len(self._newest) else 0.0
        is_loud = 10.0 * math.log10(power + 1e-12) > self._silence_dbfs
        return Verdict(MUSIC if is_loud else SKIP, math.nan, math.nan, math.nan, self.name)
