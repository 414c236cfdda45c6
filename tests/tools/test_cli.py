"""The command line: wrong input is one sentence and exit code 2; every command has its help."""

import errno
import os
import subprocess
import sys

import numpy as np
import pytest
import soundfile

from downbeat.tools.cli import main

RULES = """name = "song"
audio = "song.wav"
default_skill = "sway"
tempo_bpm = 120.0
[[section]]
start_s = 0.0
end_s = 10.0
skill = "{skill}"
[[section]]
start_s = {second}
end_s = 20.0
skill = "kpop"
"""


@pytest.fixture
def folder(tmp_path):
    """Two recordings of 25 s, and an empty folder for rules."""
    rng = np.random.default_rng(0)
    for name in ("song", "other"):
        soundfile.write(tmp_path / f"{name}.wav", 0.1 * rng.standard_normal(25 * 22_050), 22_050)
    (tmp_path / "rules").mkdir()
    return tmp_path


def fails(capsys, *argv):
    """Run a command that must end with 2; return what it said."""
    assert main(list(argv)) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("downbeat: ")
    assert "Traceback" not in said
    return said


def mashup(folder, *more):
    runs = ("--runs", str(folder / "runs"))
    return ("eval", "mashup", "--tracks", str(folder), *runs, *more)


def test_missing_folder_of_tracks(capsys, tmp_path):
    said = fails(capsys, *mashup(tmp_path / "nowhere"))
    assert "nowhere" in said and ".flac" in said


def test_folder_without_sound(capsys, tmp_path):
    (tmp_path / "notes.txt").write_text("la la")
    assert "valid are .wav, .flac, .ogg, .mp3" in fails(capsys, *mashup(tmp_path))


def test_file_that_is_no_sound(capsys, tmp_path):
    (tmp_path / "fake.wav").write_text("la la")
    assert "no recording that can be read" in fails(capsys, *mashup(tmp_path))


def test_sections_longer_than_every_track(capsys, folder):
    said = fails(capsys, *mashup(folder, "--section-seconds", "200"))
    assert "200" in said and "song" in said


def test_unknown_skill_in_a_rule_names_file_and_key(capsys, folder):
    (folder / "rules" / "song.toml").write_text(
        RULES.format(skill="moonwalk", second=10.0).replace("song.wav", "../song.wav")
    )
    said = fails(capsys, *mashup(folder, "--rules", str(folder / "rules")))
    assert "Skill 'moonwalk' is unknown" in said and "song.toml:section[0].skill" in said
    assert "kpop" in said


def test_overlapping_sections_name_file_and_key(capsys, folder):
    (folder / "rules" / "song.toml").write_text(
        RULES.format(skill="sway", second=8.0).replace("song.wav", "../song.wav")
    )
    said = fails(capsys, *mashup(folder, "--rules", str(folder / "rules")))
    assert "overlaps" in said and "song.toml:section[1]" in said


def test_rule_whose_audio_is_missing(capsys, folder):
    (folder / "rules" / "song.toml").write_text(RULES.format(skill="sway", second=10.0))
    said = fails(capsys, *mashup(folder, "--rules", str(folder / "rules")))
    assert "does not exist" in said and "song.toml:audio" in said


def test_show_file_with_an_unknown_key(capsys, tmp_path):
    show = tmp_path / "show.toml"
    show.write_text('audio = "a.wav"\ntracks = "t"\nindex = "i"\ncolour = "red"\n')
    said = fails(capsys, "control", "--show", str(show))
    assert "colour" in said and "set_list" in said and "show.toml" in said


def test_unknown_names_list_the_known_ones(capsys, tmp_path):
    assert "kpop" in fails(capsys, "policy", "inspect", "moonwalk")
    assert "lockstep" in fails(capsys, "bench", "--only", "coffee")
    assert "140" in fails(capsys, "eval", "beat", "--bpm", "99", "--runs", str(tmp_path / "runs"))
    said = fails(capsys, "demo", "--section-seconds", "500", "--runs", str(tmp_path / "runs"))
    assert "valid are 10 to" in said


def test_report_of_an_empty_folder(capsys, tmp_path):
    assert "downbeat: " in fails(capsys, "report", str(tmp_path))


COMMANDS = (
    "demo eval catalog policy sim listen conduct control record ask stop arm report spy doctor "
    "bench export"
)


@pytest.mark.parametrize("command", COMMANDS.split())
def test_every_subcommand_explains_itself(capsys, command):
    with pytest.raises(SystemExit) as stopped:
        main([command, "--help"])
    assert stopped.value.code == 0
    assert len(capsys.readouterr().out) > 100


def test_exported_model_is_the_robot(tmp_path, capsys):
    import mujoco

    assert main(["export", "mjcf", "--out", str(tmp_path / "g1.xml")]) == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "g1.xml"))
    assert model.nu == 29


def test_whatever_is_started_from_the_tools_has_one_blas_thread_unless_told_otherwise():
    """On several, OpenBLAS spins: a query of 5 ms then takes 8, and now and then a second."""
    code = "import downbeat.tools, os; print(os.environ['OPENBLAS_NUM_THREADS'])"
    bare = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    for env, threads in ((bare, "1"), ({**bare, "OPENBLAS_NUM_THREADS": "3"}, "3")):
        run = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
        assert run.stdout.strip() == threads, run.stderr


@pytest.mark.parametrize(
    "argv",
    [
        ["--help"],
        ["catalog", "show"],  # a table
        ["policy", "inspect", "kpop"],
        ["eval", "chunks", "--json", "--per-shift=0", "--per-condition=0", "--tracks", "FOLDER"],
        ["catalog", "match", "--help"],
    ],
)
def test_a_command_whose_output_nobody_reads_ends_quietly(argv, folder):
    reader, writer = os.pipe()
    os.close(reader)
    argv = [str(folder) if word == "FOLDER" else word for word in argv]
    command = [sys.executable, "-m", "downbeat.tools.cli", *argv]
    with os.fdopen(writer, "w") as out:
        done = subprocess.run(command, stdout=out, stderr=subprocess.PIPE, text=True, check=False)
    assert "Broken" not in done.stderr and "Traceback" not in done.stderr
    assert done.returncode == 141


def test_a_pipe_that_breaks_elsewhere_is_no_unread_output(monkeypatch):
    def fail(self):
        raise BrokenPipeError("a service went away")

    monkeypatch.setattr("downbeat.tools.commands.catalog.Show.run", fail)
    with open(os.devnull, "w") as nowhere:
        monkeypatch.setattr(sys, "stdout", nowhere)
        monkeypatch.setattr(sys, "stderr", nowhere)
        with pytest.raises(BrokenPipeError, match="service"):
            main(["catalog", "show"])


FULL = "/dev/full"
full_disk = pytest.mark.skipif(not os.path.exists(FULL), reason="only Linux has a full device")


@full_disk
@pytest.mark.parametrize("unbuffered", [[], ["-u"]])
@pytest.mark.parametrize(
    "argv",
    [
        ["--help"],
        ["catalog", "show"],  # a table
        ["policy", "inspect", "kpop"],
        ["arm", "--help"],
    ],
)
def test_output_that_the_disk_does_not_take_is_one_sentence(argv, unbuffered):
    command = [sys.executable, *unbuffered, "-m", "downbeat.tools.cli", *argv]
    with open(FULL, "w") as out:
        done = subprocess.run(command, stdout=out, stderr=subprocess.PIPE, text=True, check=False)
    said = "downbeat: standard output cannot be written: No space left on device.\n"
    assert done.stderr == said
    assert done.returncode == 1


@full_disk
@pytest.mark.parametrize("argv", [["catalog", "show", "nowhere"], ["no such command"]])
def test_errors_that_cannot_be_written_are_no_traceback_either(argv):
    command = [sys.executable, "-m", "downbeat.tools.cli", *argv]
    with open(FULL, "w") as out:
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=out, text=True, check=False)
    assert done.returncode == 1 and not done.stdout.strip()


def test_a_disk_that_is_full_elsewhere_is_not_called_standard_output(monkeypatch, tmp_path):
    def fail(self):
        raise OSError(errno.ENOSPC, "No space left on device", "journal")

    monkeypatch.setattr("downbeat.tools.commands.catalog.Show.run", fail)
    with open(tmp_path / "out", "w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        with pytest.raises(OSError, match="journal"):
            main(["catalog", "show"])
