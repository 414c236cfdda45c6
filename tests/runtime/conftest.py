import socket

import pytest

from downbeat.runtime.bus import MulticastError, parse_udpm_url
from downbeat.runtime.udpm import check_multicast


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
