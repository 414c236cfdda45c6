"""Configuration: types are the schema; every error names file:key and what is valid."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from downbeat.runtime.config import ConfigError, load_config, plain


@dataclass(frozen=True)
class Plant:
    friction: float = 0.6
    seed: int = 0


@dataclass(frozen=True)
class Entry:
    track: str
    seconds: float


@dataclass(frozen=True)
class Show:
    sound: Path
    mode: Literal["lockstep", "real_time"] = "real_time"
    announced: bool = True
    plant: Plant = Plant()
    entries: tuple[Entry, ...] = ()
    window_s: tuple[float, float] = (0.0, 1.0)
    gains: dict[str, float] = field(default_factory=dict)
    label: str | None = None

    def __post_init__(self):
        if self.label == "bad":
            raise ValueError("label may not be bad")


def load(tmp_path, text):
    path = tmp_path / "show.toml"
    path.write_text(text)
    return load_config(path, Show)


def test_whole_file_becomes_frozen_dataclasses(tmp_path):
    show = load(
        tmp_path,
        """
        sound = "mix.wav"
        mode = "lockstep"
        label = "x"
        window_s = [1, 2.5]
        gains = {knee = 2}
        [plant]
        friction = 1
        [[entries]]
        track = "a"
        seconds = 20
        """,
    )
    assert show == Show(
        sound=tmp_path / "mix.wav",
        mode="lockstep",
        plant=Plant(friction=1.0),
        entries=(Entry("a", 20.0),),
        window_s=(1.0, 2.5),
        gains={"knee": 2.0},
        label="x",
    )
    assert plain(show)["entries"] == [{"track": "a", "seconds": 20.0}]
    assert plain(show)["sound"] == str(tmp_path / "mix.wav")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"show.toml:sound is missing; it is a path"),
        ("sound = 3", r"show.toml:sound is 3, valid is a path"),
        (
            'sound = "a"\nsond = 1',
            r"show.toml:sond is not known here; known are announced, .*sound",
        ),
        ('sound = "a"\nplant.seed = 1.5', r"show.toml:plant.seed is 1.5, valid is an integer"),
        ('sound = "a"\nplant.seed = true', r"plant.seed is True, valid is an integer"),
        (
            'sound = "a"\nplant.frict = 1',
            r"plant.frict is not known here; known are friction, seed",
        ),
        ('sound = "a"\nplant = 1', r"show.toml:plant is 1, valid is a table"),
        ('sound = "a"\nmode = "fast"', r"mode is 'fast', valid is one of lockstep, real_time"),
        ('sound = "a"\nannounced = "yes"', r"announced is 'yes', valid is true or false"),
        ('sound = "a"\nentries = 3', r"entries is 3, valid is a list"),
        ('sound = "a"\nentries = [{track = "a"}]', r"entries\[0\].seconds is missing"),
        ('sound = "a"\nwindow_s = [1]', r"window_s has 1 items, valid is 2"),
        ('sound = "a"\ngains = 1', r"gains is 1, valid is a table"),
        ('sound = "a"\nlabel = "bad"', r"label may not be bad"),
        ("sound = ", r"show.toml is not TOML"),
    ],
)
def test_error_names_the_key_and_what_is_valid(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, text)


def test_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(ConfigError, match="none.toml cannot be read"):
        load_config(tmp_path / "none.toml", Show)
