"""Calibrate the embedded recogniser: speak commands and other sentences, freeze what decides.

`python -m downbeat.tools.calibrate_recogniser` prints the table of the frozen calibration over
test voices and test sentences; with `--write` it first makes a new one from calibration voices
and calibration sentences, which the test never hears. Nothing of the test is used to choose. What
counts is what the robot would do: the words are understood as the speech process does it.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.perception.recogniser_pocketsphinx import (
    CALIBRATION_FILE,
    FEATURES,
    VOICES,
    Calibration,
    Decision,
    PocketsphinxRecogniser,
    load_calibration,
)
from downbeat.policies.manifest import load_skills
from downbeat.tools.recogniser_heard import Heard, hear, hear_people, hear_talk
from downbeat.tools.recogniser_items import Understanding, items, talk
from downbeat.tools.speech_parts import sayable

MAX_FALSE_ACCEPTS = {"people": 0.005, "synthetic": 0.01}
"""On calibration sentences; the test is to stay within 3 %. People talk to others all day long."""
CALIBRATION_SNRS = (20.0, 10.0)
RIDGE = 0.1
TALK = 240
"""Sentences about dances and anything else, as the utterances they are cut into by their pauses:
a half of one sounds more like a command than the whole ("a monkey escaped | from the zoo")."""


def fit(heard: list[Heard], max_false_accepts: float) -> Decision:
    """Return the logistic regression of "this was said", and the threshold.

    Wrong answers to real commands count as not said, so they are refused like other sentences.
    """
    rows = [one for one in heard if one.text]
    x = np.array([one.features for one in rows])  # (n, f)
    y = np.array([one.right for one in rows], float)
    centre, spread = x.mean(0), x.std(0)
    z = np.column_stack(((x - centre) / spread, np.ones(len(x))))
    w = np.zeros(z.shape[1])
    for _ in range(50):  # Newton's method with a little ridge
        p = 1 / (1 + np.exp(-z @ w))
        curve = z.T @ (z * (p * (1 - p))[:, None]) + RIDGE * np.eye(len(w))
        w += np.linalg.solve(curve, z.T @ (y - p) - RIDGE * w)
    weights = w[:-1] / spread
    offset = float(w[-1] - weights @ centre)
    made = Decision(tuple(float(v) for v in weights), offset, 0.0)
    foreign = [one for one in heard if one.item.kind in ("sentence", "language")]
    scores = np.sort([made.confidence(one.features) if one.meaning else 0.0 for one in foreign])
    allowed = int(max_false_accepts * len(scores))
    threshold = float(np.nextafter(scores[len(scores) - 1 - allowed], 2.0))
    return Decision(made.weights, offset, threshold)


def is_taken(one: Heard, calibration: Calibration) -> bool:
    """Return whether the recogniser answers."""
    decision = calibration.by_voice[one.voice]
    return bool(one.text) and decision.confidence(one.features) >= decision.threshold


def rates(heard: list[Heard], calibration: Calibration) -> dict[str, Any]:
    """Return the shares of right, wrong and refused commands and of false accepts."""

    def share(kind: str, test: Callable[[Heard, bool], bool]) -> float:
        rows = [(one, ok) for one, ok in taken if one.item.kind == kind]
        return round(sum(test(one, ok) for one, ok in rows) / len(rows), 4) if rows else math.nan

    taken = [(one, is_taken(one, calibration)) for one in heard]
    return {
        "commands": sum(one.item.kind == "command" for one in heard),
        "right": share("command", lambda one, ok: ok and one.right),
        "wrong": share("command", lambda one, ok: ok and bool(one.meaning) and not one.right),
        "refused": share("command", lambda one, ok: not ok or not one.meaning),
        "right_before_refusal": share("command", lambda one, ok: one.right),
        "questions_right": share("question", lambda one, ok: ok and one.right),
        "sentences": sum(one.item.kind == "sentence" for one in heard),
        "false_accepts": share("sentence", lambda one, ok: ok and bool(one.meaning)),
        "false_answers": share("sentence", lambda one, ok: ok and not one.meaning),
        "false_accepts_languages": share("language", lambda one, ok: ok and bool(one.meaning)),
        "real_time_factor": round(
            sum(one.compute_s for one in heard) / sum(one.sound_s for one in heard), 4
        ),
    }


def calibrate(share: int = 1, people: Path | None = None) -> tuple[Calibration, dict[str, Any]]:
    """Return a new calibration from the calibration half, and its own rates at 20 dB.

    Args:
        share: Only every so many-th utterance.
        people: Folder of recordings of people who command nothing.
    """
    recogniser = PocketsphinxRecogniser(sayable(load_skills()), load_blank())
    understanding = Understanding()
    spoken = items("calibration", share)
    random.Random(0).shuffle(spoken)
    at = {
        snr: list(hear(recogniser, understanding, spoken, snr, 1, VOICES))
        for snr in CALIBRATION_SNRS
    }
    heard = [one for rows in at.values() for one in rows]
    near = talk(TALK // share)
    for snr in CALIBRATION_SNRS:
        heard += hear_talk(recogniser, understanding, near, snr, 3)
    levels = " and ".join(f"{snr:g}" for snr in CALIBRATION_SNRS)
    info = f"{len(spoken)} utterances of espeak-ng at {levels} dB, calibration voices and sentences"
    info += f"; {len(near)} sentences of talk, cut into utterances"
    if people is not None:
        others = list(hear_people(recogniser, understanding, people))
        heard += others
        info += f"; {len(others)} utterances and pieces of people's speech"
    made = {
        voice: fit([one for one in heard if one.voice == voice], MAX_FALSE_ACCEPTS[voice])
        for voice in VOICES
    }
    calibration = Calibration(made, info)
    return calibration, {
        voice: rates([one for one in at[20.0] if one.voice == voice], calibration)
        for voice in VOICES
    }


def load_blank() -> Calibration:
    """Return a calibration that refuses nothing."""
    return Calibration(dict.fromkeys(VOICES, Decision((0.0,) * len(FEATURES), 0.0, 0.0)))


def write(calibration: Calibration) -> None:
    """Freeze it where the recogniser looks."""
    table: dict[str, Any] = {"info": calibration.info}
    for voice, decision in calibration.by_voice.items():
        table[voice] = {
            "weights": dict(zip(FEATURES, (round(w, 6) for w in decision.weights), strict=True)),
            "offset": round(decision.offset, 6),
            "threshold": round(decision.threshold, 6),
        }
    CALIBRATION_FILE.parent.mkdir(exist_ok=True)
    CALIBRATION_FILE.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")


def evaluate(snr_db: float = 20.0, share: int = 1, details: bool = False) -> dict[str, Any]:
    """Return the rates of the frozen calibration on the test half."""
    calibration = load_calibration()
    recogniser = PocketsphinxRecogniser(sayable(load_skills()), calibration)
    heard = list(hear(recogniser, Understanding(), items("test", share), snr_db, seed=2))
    found = {"snr_db": snr_db, **rates(heard, calibration)}
    if details:
        found["confused"] = [
            f"{one.item.text} ({one.item.voice}) -> {one.text}"
            for one in heard
            if one.meaning and not one.right and is_taken(one, calibration)
        ]
    return found


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="make and freeze a new calibration")
    parser.add_argument(
        "--people", type=Path, help="with --write: folder of speech that commands nothing"
    )
    parser.add_argument("--snr-db", type=float, nargs="*", default=[20.0], help="of the test")
    parser.add_argument("--share", type=int, default=1, help="only every so many-th utterance")
    parser.add_argument("--details", action="store_true", help="list what was accepted wrongly")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    result: dict[str, Any] = {}
    if arguments.write:
        made, result["calibration"] = calibrate(arguments.share, arguments.people)
        write(made)
    result["test"] = [evaluate(snr, arguments.share, arguments.details) for snr in arguments.snr_db]
    result["peak_memory_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    if arguments.json:
        print(json.dumps(result))
        return
    rows = [(f"calibration, {name}", row) for name, row in result.get("calibration", {}).items()]
    rows += [(f"test {row['snr_db']:g} dB", row) for row in result["test"]]
    for title, row in rows:
        print(title)
        for key, value in row.items():
            print(f"  {key:<26}{value}")
    print(f"peak memory of the process: {result['peak_memory_mib']} MiB", file=sys.stderr)


if __name__ == "__main__":
    main()
