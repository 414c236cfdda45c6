"""Sweeps are content: killed, sharded or spread, the rows are those of one run."""

import io
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from downbeat.sim.batch.pair import Depth
from downbeat.sim.batch.sweep import SweepConfig, pairs_of, run_sweep, sweep_skills

SKILLS = ("stand", "sway", "wave")
SHALLOW = Depth(target=0.5, max_blocks=2, robots=12)
RUN = """
import sys
from pathlib import Path
from downbeat.sim.batch.pair import Depth
from downbeat.sim.batch.sweep import SweepConfig, run_sweep
if __name__ == "__main__":
    depth = Depth(target=0.5, max_blocks=2, robots=12)
    run_sweep(SweepConfig(Path(sys.argv[1]), ("stand", "sway", "wave"), depth=depth, workers=2))
"""


def config(out: Path, **changes) -> SweepConfig:
    return replace(SweepConfig(out, SKILLS, depth=SHALLOW), **changes)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.npy")}


def count_rows(files: dict[str, bytes]) -> int:
    return sum(len(np.load(io.BytesIO(data))) for data in files.values())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One uninterrupted run in one process."""
    out = tmp_path_factory.mktemp("whole")
    run_sweep(config(out))
    return contents(out)


def test_a_run_holds_every_ordered_pair_once(whole):
    assert len(whole) == len(pairs_of(sweep_skills(config(Path())), (0, 1))) == 6


def children(pid: int) -> list[int]:
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True)
    return [int(line) for line in found.stdout.split()]


def test_a_sweep_killed_at_any_moment_goes_on_without_a_lost_or_doubled_row(whole, tmp_path):
    script = tmp_path / "run.py"
    script.write_text(RUN)
    out = tmp_path / "rows"
    process = subprocess.Popen([sys.executable, str(script), str(out)])
    deadline = time.monotonic() + 120.0
    while not contents(out) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    workers = children(process.pid)
    process.send_signal(signal.SIGKILL)
    process.wait()
    partial = contents(out)
    assert 0 < len(partial) < len(whole)
    time.sleep(1.0)
    alive = [pid for pid in workers if Path(f"/proc/{pid}").exists() and not _zombie(pid)]
    assert alive == []  # a killed sweep leaves nothing behind

    progress = run_sweep(config(out))
    assert contents(out) == whole
    assert 0 < progress.rollouts <= count_rows(whole) - count_rows(partial)


def _zombie(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_two_shards_put_together_are_one_run(whole, tmp_path):
    merged = tmp_path / "merged"
    merged.mkdir()
    for index in range(2):
        part = tmp_path / f"shard{index}"
        run_sweep(config(part, shard=(index, 2)))
        assert 0 < len(contents(part)) < len(whole)
        for path in part.glob("*.npy"):
            assert not (merged / path.name).exists()
            shutil.copy(path, merged)
    assert contents(merged) == whole


def test_a_finished_sweep_has_nothing_left_to_do(whole, tmp_path):
    for name, data in whole.items():
        (tmp_path / name).write_bytes(data)
    assert run_sweep(config(tmp_path)).rollouts == 0


@pytest.mark.slow
# Ray forks to execute its own servers, at once: that JAX runs in this process does not matter.
@pytest.mark.filterwarnings("ignore:os\\.fork:RuntimeWarning")
@pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed (extra `sweep`)")
def test_a_cluster_of_two_workers_gives_the_rows_of_one_process(whole, tmp_path):
    from downbeat.sim.batch.cluster import spread_ray

    out = tmp_path / "rows"
    run_sweep(config(out, workers=2), spread=spread_ray())
    assert contents(out) == whole
