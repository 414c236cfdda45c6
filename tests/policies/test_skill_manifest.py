from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import pytest

from downbeat.policies.errors import PolicyError
from downbeat.policies.generator.build import SKILL_NAMES
from downbeat.policies.manifest import BUNDLED_SKILLS, load_manifest, load_skills
from downbeat.policies.toml_text import to_toml

MAX_BUNDLE_BYTES = 25_000_000


@pytest.fixture
def stand_folder(tmp_path: Path) -> Path:
    """A copy of the stand that a test may spoil."""
    return Path(shutil.copytree(BUNDLED_SKILLS / "stand", tmp_path / "stand"))


def spoil(folder: Path, **changes: object) -> Path:
    """Change keys of a manifest; None removes one."""
    path = folder / "manifest.toml"
    table = tomllib.loads(path.read_text()) | changes
    path.write_text(to_toml({key: value for key, value in table.items() if value is not None}))
    return path


def test_every_skill_of_the_generator_is_bundled_and_matches_its_sha256() -> None:
    assert set(load_skills()) == set(SKILL_NAMES)


def test_the_bundle_stays_small() -> None:
    size = sum(manifest.onnx_path.stat().st_size for manifest in load_skills().values())
    assert size < MAX_BUNDLE_BYTES


def test_every_bundled_skill_carries_a_passed_certificate() -> None:
    for name, manifest in load_skills().items():
        assert manifest.certificate is not None, name
        assert manifest.certificate.passed, name


def test_dances_follow_100_to_140_bpm() -> None:
    for name, manifest in load_skills().items():
        if manifest.bpm:
            low, high = manifest.tempo_range_bpm
            assert low <= 100.0 and high >= 140.0, name


def test_footwork_is_entered_and_left_at_listed_phases_that_include_zero() -> None:
    for manifest in load_skills().values():
        if manifest.kind == "stepping":
            assert manifest.entry_phases_s == (0.0,)
            assert manifest.exit_phases_s is not None and 0.0 in manifest.exit_phases_s


def test_loops_are_exact_in_time() -> None:
    for manifest in load_skills().values():
        if manifest.bpm:
            assert manifest.duration_s == pytest.approx(manifest.beats * 60.0 / manifest.bpm)
            assert manifest.ticks == round(manifest.duration_s / 0.02)


def test_a_changed_onnx_file_is_refused(stand_folder: Path) -> None:
    with (stand_folder / "stand.onnx").open("ab") as file:
        file.write(b"x")
    with pytest.raises(PolicyError, match="SHA-256.*manifest.toml:sha256"):
        load_manifest(stand_folder / "manifest.toml")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colour": "red"}, "'colour' is unknown; keys are beats, bpm"),
        ({"bpm": None}, "'bpm' is missing"),
        ({"kind": "flying"}, "'flying' is unknown; kinds are locomotion, planted, stepping"),
        ({"name": "sit"}, "'sit' lies in folder 'stand'"),
        ({"ticks": 2.5}, "2.5 is not a whole number .*manifest.toml:ticks"),
        ({"tempo_range_bpm": [1.0]}, "list of 2 numbers .*manifest.toml:tempo_range_bpm"),
        ({"file": "other.onnx"}, "other.onnx does not exist .*manifest.toml:file"),
        ({"kind": "locomotion"}, r"needs a \[command\] table"),
        ({"bpm": 120.0}, "outside 0..0 .*manifest.toml:tempo_range_bpm"),
    ],
)
def test_errors_name_file_and_key(
    stand_folder: Path, changes: dict[str, object], message: str
) -> None:
    path = spoil(stand_folder, **changes)
    with pytest.raises(PolicyError, match=message):
        load_manifest(path)


def test_an_empty_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="has no NAME/manifest.toml"):
        load_skills(tmp_path)


def test_toml_text_reads_back_as_it_was_written() -> None:
    table = {
        "text": 'a "quoted" \\ line\nend',
        "yes": True,
        "many": [float(k) / 3.0 for k in range(40)],
        "inner": {"x": 1, "list": [{"a": 1.5}, {"a": 2.0}]},
    }
    read = tomllib.loads(to_toml(table))
    assert read["many"] == pytest.approx(table["many"])
    assert {**read, "many": 0} == {**table, "many": 0}
