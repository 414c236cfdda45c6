"""What all tests share: hypothesis without clocks, a bus of one's own, real recordings."""

import socket
from pathlib import Path

import pytest
from hypothesis import settings

from downbeat.runtime.bus import MulticastError, parse_udpm_url
from downbeat.runtime.udpm import check_multicast

pytest_plugins = ["downbeat.tools.pytest_plugin"]

# A deadline is a wall-clock assertion, and this suite has none.
settings.register_profile("downbeat", deadline=None, max_examples=60)
settings.load_profile("downbeat")

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def real_music() -> Path:
    """Folder of real recordings; a user's clone has none."""
    folder = SHARED / "audio" / "music"
    if not folder.is_dir():
        pytest.skip("no ../shared/audio/music beside this checkout")
    return folder


@pytest.fixture
def free_url():
    """LCM URL with a port of its own, ttl=0; skips where there is no multicast."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    url = f"udpm://239.255.76.67:{min(port, 65533)}?ttl=0"
    try:
        check_multicast(parse_udpm_url(url))
    except MulticastError as error:
        pytest.skip(str(error))
    return url
