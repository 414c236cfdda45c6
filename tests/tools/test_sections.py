"""Section changes: their score, their mashups, and that what is learned tells pieces apart."""

import json

import numpy as np
import pytest
import soundfile

from downbeat.perception import section_features as sf
from downbeat.perception.section_finder import MIN_PAST, load_weights
from downbeat.perception.source import Recording
from downbeat.tools import eval_sections as eval_module
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_sections import eval_sections, find_changes, mashup_of, sound_of
from downbeat.tools.section_mashups import MASHUP_S, pool_of, varied_mashup
from downbeat.tools.section_score import NEAR_S, SectionScore, interval
from downbeat.tools.train_sections import frames_of, inputs_of, learn, nearest_frames, save

RATE = sf.RATE_HZ


def piece(number, seconds=45.0):
    """A plain piece of its own key, tempo and timbre."""
    rng = np.random.default_rng(number)
    t = np.arange(round(seconds * RATE)) / RATE
    root = 110.0 * 2.0 ** rng.uniform(0.0, 2.0)
    beat_s = rng.uniform(0.3, 0.7)
    steps = rng.choice([1.0, 1.125, 1.25, 1.5], 8)
    pitch = root * steps[(t / beat_s).astype(int) % 8]
    tone = np.sin(2.0 * np.pi * np.cumsum(pitch) / RATE)
    pulse = np.exp(-((t % beat_s) * rng.uniform(8.0, 30.0))) * rng.standard_normal(len(t))
    sound = 0.1 * np.tanh(rng.uniform(0.5, 4.0) * tone) + rng.uniform(0.02, 0.2) * pulse
    return Recording(f"game{number % 2}_{number}", sound.astype(np.float32), RATE)


def level(number, seconds=60.0):
    """A recording that is told by its level."""
    samples = np.full(round(seconds * RATE), 0.1 * (number + 1), np.float32)
    return Recording(f"level_{number}", samples, RATE)


def test_a_change_is_counted_once_and_where_it_is():
    score = SectionScore()
    told = [(3.0, 4.8), (20.05, 21.9), (20.4, 22.2), (39.3, 41.1), (70.0, 71.8)]
    score.add(told, [20.0, 40.0, 60.0])
    assert (score.told, score.cuts) == (4, 3)  # what is told in the first 5 s does not count
    assert (score.found, score.close, score.rough) == (1, 1, 2)
    assert score.latency_s == pytest.approx([1.9])


def test_the_interval_of_a_share_is_wilsons():
    assert interval(45, 50) == pytest.approx((0.7864, 0.9565), abs=1e-3)
    assert interval(0, 0) == (0.0, 1.0)


@pytest.fixture
def folder(tmp_path):
    """Two recordings of 45 s, one of 35, and files that are none or too short."""
    for number, seconds in ((0, 45.0), (1, 45.0), (2, 35.0)):
        soundfile.write(tmp_path / f"piece{number}.wav", piece(number, seconds).samples, RATE)
    soundfile.write(tmp_path / "jingle.wav", piece(3, 4.0).samples, RATE)
    soundfile.write(tmp_path / "empty.wav", np.zeros(0, np.float32), RATE)
    (tmp_path / "broken.flac").write_bytes(b"nonsense")
    return tmp_path


def test_a_bad_file_is_named_in_a_sentence_and_left_out(folder):
    said = []
    names = [one.name for one in sound_of(folder, said.append)]
    assert names == ["piece0", "piece1", "piece2"]
    assert len(said) == 3 and all(words.startswith("left out") for words in said)
    for name in ("broken.flac cannot be read", "empty.wav holds no usable", "jingle (4.0 s)"):
        assert sum(name in words for words in said) == 1, said
    (folder / "piece0.wav").unlink()
    (folder / "piece1.wav").write_bytes(b"nonsense")
    with pytest.raises(ToolError, match="holds 1 recording of 31 s or more, two are needed"):
        sound_of(folder, said.append)


def test_recordings_shorter_than_a_section_are_left_out(folder, capsys, monkeypatch):
    monkeypatch.setattr(eval_module, "find_changes", lambda sound: [])  # cuts are at stake here
    assert eval_sections(folder, (20.0, 40.0), 1, 0, True) == 0
    out, err = capsys.readouterr()
    rows = json.loads(out)["sections"]
    assert {name: row["recordings"] for name, row in rows.items()} == {"20": 3, "40": 2}
    assert {row["cuts"] for row in rows.values()} == {5}  # six sections each, none cut short
    assert "left out (shorter than 40 s): piece2 (35.0 s)" in err


@pytest.mark.parametrize(
    ("section_s", "mashups", "fade_s", "words"),
    [
        ((60.0,), 1, 0.0, "0 recordings of 60 s or more.*second longest has 45.0 s"),
        ((20.0, 0.0), 1, 0.0, "--section-seconds 0 cannot be judged"),
        ((), 1, 0.0, "at least one length"),
        ((float("nan"),), 1, 0.0, "--section-seconds nan"),
        ((20.0,), 1, 30.0, "--fade-seconds 30 does not fit.*0 to half"),
        ((20.0,), 0, 0.0, "--mashups 0"),
    ],
)
def test_sections_that_cannot_be_cut_are_one_sentence(folder, section_s, mashups, fade_s, words):
    with pytest.raises(ToolError, match=words):
        eval_sections(folder, section_s, mashups, 0, True, fade_s)


def test_silence_to_cut_from_is_one_sentence():
    silent = [Recording(f"s{n}", np.zeros(40 * RATE, np.float32), RATE) for n in range(3)]
    with pytest.raises(ToolError, match="no two have a passage of 10 s that sounds"):
        mashup_of([piece(0), *silent], 60.0, (10.0, 10.0), np.random.default_rng(0))


@pytest.mark.parametrize("fade_s", [0.0, 0.5])
def test_cuts_are_where_the_sound_changes(fade_s):
    tracks = [level(number) for number in range(3)]
    rng = np.random.default_rng(1)
    sound, cuts_s = mashup_of(tracks, 40.0, (8.0, 8.0), rng, fade_s)
    assert len(cuts_s) >= 4
    for cut_s in cuts_s:
        before, after = (round((cut_s + side * (0.5 * fade_s + 0.01)) * RATE) for side in (-1, 1))
        assert sound[before] != sound[after]
        assert np.ptp(sound[before - 100 : before]) == np.ptp(sound[after : after + 100]) == 0.0


def test_varied_mashups_name_their_cuts():
    pool = pool_of([level(number) for number in range(5)])
    assert [len(kin) for kin in pool.kin] == [5]
    for seed in (3, 4, 7, 9):  # without noise, room and fades
        sound, cuts = varied_mashup(pool, np.random.default_rng(seed))
        assert len(sound) == MASHUP_S * RATE
        jumps = np.flatnonzero(np.abs(np.diff(sound)) > 1e-4 * np.abs(sound).max()) + 1
        assert len(jumps) < 1000  # cuts, and what resampling makes of an end
        assert set(cuts) <= set(jumps.tolist())


def test_what_is_learned_tells_pieces_apart(tmp_path):
    pool = pool_of([piece(number) for number in range(10)])
    weights = learn(pool, 10.0, np.random.default_rng(0))
    save(weights, tmp_path / "weights.npz")
    load_weights.cache_clear()
    loaded = load_weights(tmp_path / "weights.npz")
    load_weights.cache_clear()
    sound, cuts_s = mashup_of([piece(n) for n in range(20, 26)], 60.0, (10.0, 10.0),
                              np.random.default_rng(2))  # fmt: skip
    inputs = inputs_of(frames_of(sound), loaded.maps)
    odds = loaded.log_odds(inputs)
    at = nearest_frames([round(cut * RATE) for cut in cuts_s])
    far = np.abs(np.arange(len(odds))[:, None] - at).min(1) > 10
    far[:MIN_PAST] = False
    highest = [odds[k - 2 : k + 3].max() for k in at]
    assert np.mean(highest > np.quantile(odds[far], 0.95)) >= 0.8
    own = weights.log_odds(inputs_of(frames_of(sound), weights.maps))
    assert np.abs(own - odds).max() < 0.2  # half precision


@pytest.mark.slow
def test_the_cuts_of_real_music_are_found(real_music):
    tracks = sound_of(real_music)
    score = SectionScore()
    for number in range(6):
        rng = np.random.default_rng([5, number])
        sound, cuts_s = mashup_of(tracks, 120.0, (20.0, 20.0), rng)
        score.add(find_changes(sound), cuts_s)
    assert score.cuts == 30
    assert score.recall >= 0.8, score.text()
    assert score.precision >= 0.8, score.text()
    assert max(score.latency_s) <= 2.0 + NEAR_S
