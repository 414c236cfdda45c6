"""What all tests share: hypothesis without clocks, and the folder of real recordings."""

from pathlib import Path

import pytest
from hypothesis import settings

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
