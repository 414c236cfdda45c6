import io
import itertools

import numpy as np
import pytest
from PIL import Image
from rich.console import Console
from synthetic_run import Script, skill_tables, write_run

from downbeat.tools.metrics import compute_metrics
from downbeat.tools.palette import skill_colours
from downbeat.tools.report import print_report
from downbeat.tools.runlog import read_run
from downbeat.tools.timeline import draw_timeline, gather, spans
from downbeat.tools.timeline_checks import LABEL_SHARE, label_sides
from downbeat.tools.truth import read_truth


def picture_of(folder):
    metrics = compute_metrics(folder, skill_tables())
    return gather(read_run(folder / "run.lcmlog"), read_truth(folder / "truth.json"), metrics, None)


def test_the_danced_row_shows_when_each_skill_really_came(tmp_path):
    picture = picture_of(write_run(tmp_path))
    begins = {span.value: span.start_s for span in picture.danced}
    assert begins["sway"] == pytest.approx(2.0, abs=0.001)
    assert begins["pump"] == pytest.approx(22.5, abs=0.001)
    assert len(picture.blends) == 4
    assert {span.value for span in picture.heard} == {"right"}


def test_wrong_locks_show_in_the_heard_strip(tmp_path):
    picture = picture_of(write_run(tmp_path, Script(wrong_windows=5)))
    assert [span.value for span in picture.heard] == ["wrong", "right"]


def test_the_picture_is_1600_pixels_wide_whatever_happened(tmp_path):
    script = Script(onsets_s=(2.0, None, 22.5, 29.98), fall_s=(33.0, 34.0))
    folder = write_run(tmp_path, script)
    path = draw_timeline(folder, compute_metrics(folder, skill_tables()))
    with Image.open(path) as picture:
        assert picture.width == 1600
        assert np.asarray(picture.convert("L")).std() > 10  # not an empty page


CHECKS = (
    (2.0, 32, 0, False),
    (9.0, 0, 0, False),  # an answer that there was no time
    (9.4, 8, 3, True),
    (20.0, None, 0, False),
    (40.2, 8, 1, False),
)


def test_table_and_picture_tell_the_same_of_every_check(tmp_path):
    folder = write_run(tmp_path, Script(checks=CHECKS))
    metrics = compute_metrics(folder, skill_tables())
    checks = picture_of(folder).checks
    assert [c.text() for c in checks] == ["0/32", "no time", "3/8", "no answer", "1/8"]
    assert [c.refused for c in checks] == [False, False, True, False, False]
    told = metrics["checks"]
    counts = {"simulated": "/", "no_time": "no time", "unanswered": "no answer"}
    assert {k: told[k] for k in counts} == {
        k: sum(words in c.text() for c in checks) for k, words in counts.items()
    }
    assert (told["asked"], told["refused"], told["rollouts"], told["rollouts_fallen"]) == (
        5, 1, 48, 4,
    )  # fmt: skip
    assert (told["latency_ms"], told["latest_after_deadline_ms"]) == (100.0, -100.0)
    console = Console(record=True, width=200, file=io.StringIO())
    print_report(metrics, console)
    assert (
        "3 of 5 plans simulated, 1 without time, 1 unanswered, 1 refused; 4 of 48 rollouts fell"
    ) in console.export_text()
    assert draw_timeline(folder, metrics).is_file()


def test_labels_of_checks_stay_in_the_panel_and_off_each_other():
    panel_s = 82.0
    times_s = (1.0, 21.0, 21.7, 22.4, 50.0, 80.06)
    bars = [(asked_s, asked_s + 0.5) for asked_s in times_s]
    sides = label_sides(bars, -1.0, 81.0)
    assert sides == ["right", "left", "", "right", "right", "left"]
    room_s = LABEL_SHARE * panel_s
    taken = list(bars)
    for (left_s, right_s), side in zip(bars, sides, strict=True):
        if side:
            taken.append(
                (right_s, right_s + room_s) if side == "right" else (left_s - room_s, left_s)
            )
    taken.sort()
    assert taken[0][0] >= -1.0 and taken[-1][1] <= 81.0
    assert all(before[1] <= after[0] for before, after in itertools.pairwise(taken))


def test_spans_cover_the_time_without_gaps():
    found = spans(np.arange(6.0), np.array(["a", "a", "b", "b", "b", "c"]))
    assert [(s.start_s, s.end_s, s.value) for s in found] == [
        (0.0, 2.0, "a"),
        (2.0, 5.0, "b"),
        (5.0, 5.0, "c"),
    ]


def test_standing_is_grey_and_skills_differ():
    colours = skill_colours(["stand", "sway", "disco", "sway"])
    assert len({colours["stand"], colours["sway"], colours["disco"]}) == 3
