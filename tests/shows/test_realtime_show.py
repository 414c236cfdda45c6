"""A short show as real processes over UDP multicast on a port of its own."""

import json
import socket

import pytest
from test_lockstep_show import show_dir  # noqa: F401  (fixture)

from downbeat.runtime.bus import MulticastError
from downbeat.tools.errors import ToolError
from downbeat.tools.report import report
from downbeat.tools.run_realtime import run_realtime


def free_url() -> str:
    """Return an LCM URL that nobody uses; ttl=0 keeps it on this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return f"udpm://239.255.76.67:{probe.getsockname()[1]}?ttl=0"


@pytest.mark.slow
def test_processes_play_a_show_over_lcm(show_dir, tmp_path):  # noqa: F811
    """How well it is danced depends on the load of the machine; that it is danced does not."""
    import shutil

    _, folder, mashup = show_dir
    for name in ("show.toml", "mashup.wav", "setlist.toml", "truth.json"):
        shutil.copy(folder / name, tmp_path)
    shutil.copytree(folder / "catalog", tmp_path / "catalog")
    from downbeat.tools.show import load_show

    show = load_show(tmp_path / "show.toml")
    try:
        run_realtime(show, tmp_path, mashup.truth["duration_s"], free_url())
    except MulticastError as error:
        pytest.skip(str(error))
    metrics = report(tmp_path)
    assert metrics["control"]["ticks"] > 1000
    assert metrics["bus"]["rejected"] == 0
    danced = {row["skill"] for row in metrics["sections"] if row["followed_fraction"] > 0.2}
    assert "kpop" in danced
    assert json.loads((tmp_path / "journal").read_text().splitlines()[0])["journal"] == 1


def test_show_refuses_company(tmp_path):
    """Somebody else on the channels means another robot or another show."""
    import threading

    from downbeat.lcm_types import estop_t
    from downbeat.runtime.bus import open_udpm
    from downbeat.runtime.clock import WallClock
    from downbeat.tools.run_realtime import refuse_company

    url = free_url()
    try:
        bus = open_udpm(url, WallClock(), "operator")
    except MulticastError as error:
        pytest.skip(str(error))
    stop = threading.Event()

    def chatter():
        while not stop.wait(0.02):
            bus.publish("ESTOP", estop_t())

    thread = threading.Thread(target=chatter)
    thread.start()
    try:
        with pytest.raises(ToolError, match="ESTOP"):
            refuse_company(url)
    finally:
        stop.set()
        thread.join()
        bus.close()
