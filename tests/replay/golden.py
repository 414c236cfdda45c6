"""The golden run: made by `python tests/replay/golden.py`, re-executed by test_golden_run.py.

A few seconds of stand, dance, footwork and a lost cable, with everything that control consumed and
computed. Who changes what control computes, on purpose or not, learns it from this file.
"""

import base64
import gzip
import json
from pathlib import Path

import numpy as np

from downbeat.control.policy import SkillLibrary
from downbeat.runtime.journal import environment
from downbeat.runtime.traffic import Impairment
from downbeat.tools.scenario import Ask, Expectation, Scenario
from downbeat.tools.traffic import run_scenario

PATH = Path(__file__).with_name("golden_run.jsonl.gz")
SKILLS = ("stand", "kpop", "discostep")
SCENARIO = Scenario(
    "A dance, footwork, a wobbling network.",
    7.0,
    ask=(Ask(1.2, "kpop"), Ask(2.4, "discostep"), Ask(5.0, "stand")),
    impair=(Impairment("G1_LOW_STATE", 2.0, 6.0, drop=0.1, jitter_ms=5.0),),
    expect=(Expectation(after_s=6.9, skill="stand", height_min_m=0.6),),
    seed=7,
)


def make() -> None:
    """Write the file again."""
    library = SkillLibrary.load(only=frozenset(SKILLS))
    outcome = run_scenario(SCENARIO, library)
    assert outcome.problems == [], outcome.problems
    policies = {name: library[name].manifest.sha256 for name in SKILLS}
    lines = [{**environment(), "policies": policies}]
    for record, seen in zip(outcome.records, outcome.ticks, strict=True):
        target = np.asarray(seen.command.joint_pos_target, np.float32)
        lines.append({**record, "target": base64.b64encode(target.tobytes()).decode()})
    text = "".join(json.dumps(line) + "\n" for line in lines)
    PATH.write_bytes(gzip.compress(text.encode(), mtime=0))


def read() -> tuple[dict, list[dict]]:
    """Return (header, records)."""
    head, *records = [json.loads(line) for line in gzip.decompress(PATH.read_bytes()).splitlines()]
    return head, records


if __name__ == "__main__":
    make()
