"""A run that was recorded once comes out the same today, bit for bit on its class of machine."""

import base64

import golden
import numpy as np
import pytest

from downbeat.control.core import ControlCore
from downbeat.control.policy import SkillLibrary
from downbeat.control.record import COMPARED, input_of, tick_record
from downbeat.runtime.journal import environment

TOLERANCE_RAD = 1e-3
"""On another CPU the last bits differ, and feedback carries them on."""


@pytest.fixture(scope="module")
def library():
    return SkillLibrary.load(only=frozenset(golden.SKILLS))


def test_golden_run_comes_out_the_same(library):
    head, records = golden.read()
    for name, digest in head["policies"].items():
        assert library[name].manifest.sha256 == digest, "policies changed: run golden.py"
    here = environment()
    same_machine = all(head[key] == here[key] for key in ("cpu", "versions"))
    core = ControlCore(library)
    for record in records:
        inputs = input_of(record)
        output = core.tick(inputs)
        target = np.frombuffer(base64.b64decode(record["target"]), np.float32)
        now = np.asarray(output.command.joint_pos_target)
        assert now == pytest.approx(target, abs=TOLERANCE_RAD), f"tick {inputs.tick}"
        again = tick_record(inputs, output)
        assert again["mode"] == record["mode"]
        assert again["skill"] == record["skill"]
        if same_machine:
            for name in COMPARED:
                now, then = again.get(name), record.get(name)
                same = now == then or now != now
                assert same, f"tick {inputs.tick}: {name}"


def test_golden_run_dances_steps_and_stands():
    _, records = golden.read()
    skills = list(dict.fromkeys(record["skill"] for record in records))
    assert skills == ["stand", "kpop", "discostep"]
    assert records[-1]["skill"] == "stand"
