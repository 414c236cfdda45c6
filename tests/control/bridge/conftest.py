import pytest
from bridge_rig import Rig

from downbeat.runtime.bus import MulticastError, parse_udpm_url
from downbeat.runtime.udpm import check_multicast


@pytest.fixture
def rig(tmp_path):
    """Makes a robot on DDS and a bridge; both must end with exit code 0."""
    pytest.importorskip("cyclonedds", reason="cyclonedds (extra g1) is not installed")
    try:
        check_multicast(parse_udpm_url(""))
    except MulticastError as error:
        pytest.skip(str(error))
    made = []

    def make(**options):
        made.append(Rig(tmp_path, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()
