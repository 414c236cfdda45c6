"""lcm-spy with our types: build the Java types jar once, then start LCM's own monitor with it."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import lcm

from downbeat import lcm_types
from downbeat.runtime.bus import parse_udpm_url
from downbeat.tools.errors import ToolError

JDK_HINT = "install a Java development kit (Debian: `apt-get install default-jdk`)"


class SpyError(ToolError):
    """lcm-spy cannot be started; the message says what to install."""


def lcm_files() -> list[Path]:
    """Return the .lcm files of the wire contract and of `bridge --compat`, sorted."""
    folder = Path(lcm_types.__file__).parent
    return sorted([*folder.glob("*_t.lcm"), *folder.glob("compat/*_lcmt.lcm")])


def types_jar_path(cache_dir: Path) -> Path:
    """Return where the jar of the present .lcm files belongs; its name follows their content."""
    digest = hashlib.sha256()
    for path in lcm_files():
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    digest.update(lcm_jar().read_bytes())
    return cache_dir / f"downbeat_types-{digest.hexdigest()[:16]}.jar"


def lcm_jar() -> Path:
    """Return LCM's own jar, which the lcm package brings.

    Raises:
        SpyError: It does not.
    """
    path = Path(lcm.__file__).resolve().parents[1] / "share" / "java" / "lcm.jar"
    if not path.is_file():
        raise SpyError(
            f"LCM's Java library is not at {path}; install the lcm package of constraints.txt."
        )
    return path


def build_types_jar(cache_dir: Path) -> Path:
    """Compile our types for Java; done before if the jar is in the cache.

    Args:
        cache_dir: Where jars are kept.

    Returns:
        The jar, for the CLASSPATH of lcm-spy.

    Raises:
        SpyError: No Java compiler, or a step failed.
    """
    jar = types_jar_path(cache_dir)
    if jar.is_file():
        return jar
    javac = _program("javac", JDK_HINT)
    lcm_gen = _lcm_program("lcm-gen")
    cache_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache_dir, prefix="types-") as work:
        sources, classes = Path(work) / "java", Path(work) / "classes"
        classes.mkdir()
        _run([lcm_gen, "--java", "--jpath", str(sources), *map(str, lcm_files())])
        java_files = [str(path) for path in sorted(sources.rglob("*.java"))]
        _run([javac, "-nowarn", "-cp", str(lcm_jar()), "-d", str(classes), *java_files])
        finished = Path(work) / jar.name
        _write_jar(finished, classes)
        # Renamed when complete: two spies that start together cannot see half a jar.
        finished.replace(jar)
    return jar


def _write_jar(jar: Path, classes: Path) -> None:
    """A jar is a zip of class files; the manifest may be absent."""
    with zipfile.ZipFile(jar, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(classes.rglob("*.class")):
            archive.write(path, path.relative_to(classes).as_posix())


def start_spy(
    url: str,
    cache_dir: Path,
    environment: Mapping[str, str] | None = None,
    output: IO[str] | None = None,
) -> subprocess.Popen[str]:
    """Start lcm-spy on a URL.

    Args:
        url: LCM URL; empty: the show's default group.
        cache_dir: Where the types jar is kept.
        environment: Environment of lcm-spy, with DISPLAY; None: our own.
        output: Where its messages go; None: to ours.

    Raises:
        SpyError: No Java, no display, or the jar cannot be built.
        BusError: The URL is not one.
    """
    merged = dict(os.environ if environment is None else environment)
    _program("java", JDK_HINT)
    if not (merged.get("DISPLAY") or merged.get("WAYLAND_DISPLAY")):
        raise SpyError(
            "lcm-spy needs a display and DISPLAY is not set; start it from a desktop, through "
            "`ssh -X`, or with `xvfb-run`."
        )
    merged["CLASSPATH"] = str(build_types_jar(cache_dir))
    merged["LCM_DEFAULT_URL"] = parse_udpm_url(url).text()
    return subprocess.Popen(
        [_lcm_program("lcm-spy")],
        env=merged,
        stdout=output,
        stderr=None if output is None else subprocess.STDOUT,
        text=True,
    )


def _program(name: str, hint: str) -> str:
    found = shutil.which(name)
    if found is None:
        raise SpyError(f"lcm-spy needs `{name}`, which is not on the PATH; {hint}.")
    return found


def _lcm_program(name: str) -> str:
    beside_python = Path(sys.executable).with_name(name)
    if beside_python.exists():
        return str(beside_python)
    return _program(name, "it comes with the lcm package")


def _run(command: list[str]) -> None:
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        lines = (result.stderr or result.stdout).strip().splitlines() or ["no message"]
        raise SpyError(f"The types jar cannot be built, {Path(command[0]).name} says: {lines[0]}")
