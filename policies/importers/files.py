"""Files of strangers: present, plain, bounded, and inside the folder that is imported."""

from __future__ import annotations

from pathlib import Path

from downbeat.policies.errors import PolicyError


def checked_file(path: Path, folder: Path, max_bytes: int) -> Path:
    """Return `path` if it is a plain file of bounded size that lies in `folder`.

    Args:
        path: The file.
        folder: What is imported; symbolic links may not lead out of it.
        max_bytes: Largest size.

    Raises:
        PolicyError: Missing, outside the folder, or too large.
    """
    try:
        if not path.resolve().is_relative_to(folder.resolve()):
            raise PolicyError(f"{path} leads outside the folder {folder} that is imported.")
        if not path.is_file():
            raise PolicyError(f"There is no file {path}.")
        size = path.stat().st_size
    except (OSError, RuntimeError, ValueError) as error:
        raise PolicyError(f"{path} cannot be read: {error}.") from error
    if size > max_bytes:
        raise PolicyError(f"{path} is larger than {max_bytes} bytes: it has {size}.")
    return path
