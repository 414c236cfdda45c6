import av
import numpy as np
import pytest
from PIL import Image
from synthetic_run import SKILLS, Script, write_run

from downbeat.tools import render
from downbeat.tools.palette import skill_colours
from downbeat.tools.truth import read_truth
from downbeat.tools.video_encode import AUDIO_RATE_HZ, VideoWriter, band_levels, load_audio
from downbeat.tools.video_overlay import Moment, Overlay
from downbeat.tools.video_scene import smooth_places, states_at


def moment(**changes):
    values = {
        "time_s": 12.0,
        "track": "neon",
        "asked": "disco",
        "danced": "disco",
        "incoming": "",
        "weight": 1.0,
        "pulse": 0.0,
        "is_fallen": False,
    }
    return Moment(**{**values, **changes})


def test_states_between_ticks_are_interpolated_with_unit_quaternions():
    utime = np.array([0, 20_000, 40_000])
    qpos = np.zeros((3, 36))
    qpos[:, 3] = 1.0
    qpos[:, 7] = (0.0, 0.2, 0.4)
    qpos[1, 3:7] = (-np.cos(0.1), 0.0, 0.0, -np.sin(0.1))  # same turn, other sign
    states = states_at(utime, qpos, np.array([10_000, 30_000, 90_000]))
    np.testing.assert_allclose(states[:, 7], (0.1, 0.3, 0.4))
    np.testing.assert_allclose(np.linalg.norm(states[:, 3:7], axis=1), 1.0)
    assert abs(states[0, 3]) > 0.99


def test_the_camera_follows_softly():
    states = np.zeros((200, 36))
    states[100:, 0] = 1.0
    places = smooth_places(states, fps=25.0)
    assert places.shape == (200, 2)
    assert places[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert places[-1, 0] == pytest.approx(1.0, abs=1e-6)
    assert np.abs(np.diff(places[:, 0])).max() < 0.02


def test_the_caption_changes_only_the_lower_edge(tmp_path):
    truth = read_truth(write_run(tmp_path) / "truth.json")
    overlay = Overlay((640, 360), truth, skill_colours(SKILLS))
    picture = Image.new("RGB", (640, 360), (200, 200, 200))
    overlay.draw(picture, moment(incoming="pump", is_fallen=True))
    pixels = np.asarray(picture)
    assert (pixels[:250] == 200).all()
    assert not (pixels[330:] == 200).all()


def test_the_caption_shows_what_is_danced(tmp_path):
    truth = read_truth(write_run(tmp_path) / "truth.json")
    overlay = Overlay((640, 360), truth, skill_colours(SKILLS))
    pictures = []
    for danced in ("disco", "pump"):
        picture = Image.new("RGB", (640, 360))
        overlay.draw(picture, moment(danced=danced))
        pictures.append(np.asarray(picture))
    assert (pictures[0] != pictures[1]).any()


def test_a_video_has_its_frames_and_its_sound(tmp_path):
    path = tmp_path / "v.mp4"
    sound = np.sin(np.arange(2 * AUDIO_RATE_HZ) * 0.05).astype(np.float32)
    with VideoWriter(path, (64, 48), 25, sound) as writer:
        for k in range(50):
            writer.add(np.full((48, 64, 3), 4 * k, np.uint8))
    with av.open(str(path)) as container:
        video, audio = container.streams.video[0], container.streams.audio[0]
        assert video.codec_context.name == "h264"
        assert video.codec_context.pix_fmt == "yuv420p"
        assert audio.codec_context.name == "aac"
        assert sum(1 for _ in container.decode(video=0)) == 50
        assert container.duration / 1e6 == pytest.approx(2.0, abs=0.1)


def test_sound_before_and_after_the_file_is_silence(tmp_path):
    import soundfile

    path = tmp_path / "a.wav"
    soundfile.write(path, np.full(16_000, 0.5), 16_000)
    samples = load_audio(path, -1.0, 3.0)
    assert samples.size == 4 * AUDIO_RATE_HZ
    assert not samples[: AUDIO_RATE_HZ - 10].any()
    assert samples[round(1.5 * AUDIO_RATE_HZ)] == pytest.approx(0.5, abs=0.02)
    assert not samples[round(2.1 * AUDIO_RATE_HZ) :].any()


def test_a_low_tone_lifts_the_low_columns():
    low = np.sin(2 * np.pi * 110.0 * np.arange(AUDIO_RATE_HZ) / AUDIO_RATE_HZ).astype(np.float32)
    high = np.sin(2 * np.pi * 5_000.0 * np.arange(AUDIO_RATE_HZ) / AUDIO_RATE_HZ)
    levels = band_levels(np.r_[low, high].astype(np.float32), 25, 10)
    assert levels.shape == (50, 10)
    assert levels[12, :3].max() > 0.8
    assert levels[45, 8:].max() > 0.8
    assert levels[12, 8:].max() < 0.2


def test_without_gl_one_line_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(render, "GL_BACKENDS", ("nothing",))
    assert render.render_video(write_run(tmp_path)) is None
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert "no video.mp4" in lines[0]


def test_a_run_becomes_a_video(tmp_path):
    done = []
    folder = write_run(tmp_path, Script())
    path = render.render_video(
        folder, progress=lambda n, total: done.append((n, total)), start_s=9.8, end_s=10.6
    )
    if path is None:
        pytest.skip("no GL here")
    assert done[-1] == (20, 20)
    with av.open(str(path)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 20
    assert frames[0].shape == (540, 960, 3)
    assert frames[5].std() > 15  # a lit scene, not a black page


def test_a_moment_becomes_a_picture(tmp_path):
    path = render.render_still(write_run(tmp_path), 12.0, tmp_path / "still.png", (320, 180))
    if path is None:
        pytest.skip("no GL here")
    with Image.open(path) as picture:
        assert picture.size == (320, 180)
        assert np.asarray(picture).std() > 15
