import numpy as np
import pytest
from PIL import Image
from synthetic_run import Script, skill_tables, write_run

from downbeat.tools.metrics import compute_metrics
from downbeat.tools.palette import skill_colours
from downbeat.tools.runlog import read_run
from downbeat.tools.timeline import draw_timeline, gather, spans
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
