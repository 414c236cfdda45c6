"""The house: folders, namespace, wheel list, import rules."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("lcm_types", "runtime", "catalog", "policies", "perception", "control", "sim", "tools")
MACHINE_PATHS = ("/" + "work/", "/" + "root/", "/" + "tmp/")


def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def tracked_files():
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    return [ROOT / name for name in listed.stdout.split("\0") if name]


def test_packages_in_pyproject_are_the_folders_on_disk():
    listed = set(project()["tool"]["setuptools"]["packages"])
    on_disk = {
        "downbeat." + ".".join(path.parent.relative_to(ROOT).parts)
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("__init__.py")
    }
    assert listed == on_disk


def test_every_folder_has_its_namespace_link():
    for folder in FOLDERS:
        link = ROOT / ".ns" / "downbeat" / folder
        assert link.is_symlink(), folder
        assert link.resolve() == ROOT / folder


def test_installed_namespace_is_this_checkout():
    import downbeat.control

    assert Path(downbeat.control.__file__).parent == ROOT / "control"


def test_no_module_imports_a_bare_folder_name():
    for path in tracked_files():
        if path.suffix != ".py" or not path.exists():
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            for name in names:
                assert name.split(".")[0] not in FOLDERS, f"{path}: import {name}"


def test_product_code_reads_no_environment_variable():
    for folder in ("control", "runtime", "perception", "catalog", "policies"):
        for path in (ROOT / folder).rglob("*.py"):
            assert "os.environ" not in path.read_text(), path


def test_tracked_files_name_no_machine_path():
    for path in tracked_files():
        if not path.is_file() or path.stat().st_size > 1_000_000 or path.name == "test_house.py":
            continue
        try:
            text = path.read_text()
        except UnicodeDecodeError:
            continue
        for needle in MACHINE_PATHS:
            assert needle not in text, f"{path}: {needle}"


def test_constraints_pin_every_base_requirement_exactly():
    pinned = {
        line.split("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    }
    for requirement in project()["project"]["dependencies"]:
        name = requirement.split(">")[0].split("=")[0].strip().lower()
        assert name in pinned, name


def test_imports_go_downward_only():
    lint = Path(sys.executable).with_name("lint-imports")
    if not lint.exists():
        pytest.skip("import-linter is not installed")
    # The linter does not follow the editable install; the links that type checkers use it does.
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".ns")}
    result = subprocess.run(
        [lint, "--no-cache"], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout


def test_control_process_loads_no_heavy_library():
    code = (
        "import sys, downbeat.control.node, downbeat.control.core\n"
        "print([m for m in ('torch', 'jax', 'mujoco', 'librosa', 'matplotlib', 'scipy')"
        " if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


CONTROL_LOADS = {"docstring_parser", "lcm", "numpy", "onnxruntime", "typing_extensions", "tyro"}
"""Third-party modules of the control process: bus, arrays, policies, and the command line."""


def test_control_process_loads_exactly_these_third_party_modules():
    code = (
        "import sys, pathlib\n"
        "import downbeat.tools.cli, downbeat.tools.processes, downbeat.tools.control_journal\n"
        "from downbeat.tools.show import Show, ShowConfig, make_core\n"
        "make_core(Show(ShowConfig('', '', ''), pathlib.Path('.')))\n"
        "files = {n: getattr(m, '__file__', None) or '' for n, m in sys.modules.items()}\n"
        "print(*sorted({n.split('.')[0] for n, f in files.items() if 'site-packages' in f}))\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    loaded = set(result.stdout.split())
    # What setuptools itself puts there for an editable install.
    loaded = {n for n in loaded if not n.startswith(("__editable__", "_distutils_hack"))}
    assert loaded == CONTROL_LOADS


@pytest.mark.slow
def test_built_wheel_works_elsewhere(tmp_path):
    dist = tmp_path / "dist"
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--outdir", dist, ROOT],
        check=True,
        capture_output=True,
    )
    (wheel,) = dist.glob("*.whl")
    site = tmp_path / "site"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--no-deps", "--target", site, wheel],
        check=True,
        capture_output=True,
    )
    # -S -E keep the editable checkout out; the dependencies come from this environment.
    deps = [p for p in sys.path if p.endswith("site-packages")]
    code = (
        f"import sys; sys.path[:0] = {[str(site), *deps]!r}\n"
        "import downbeat.control, pathlib\n"
        "from downbeat.policies.manifest import load_skills\n"
        "from downbeat.catalog.robot import load_g1\n"
        "from downbeat.tools import cli\n"
        f"assert pathlib.Path(downbeat.control.__file__).is_relative_to({str(site)!r})\n"
        "assert 'stand' in load_skills() and load_g1().total_mass > 33\n"
        "from downbeat.control.policy import SkillLibrary\n"
        "SkillLibrary.load(only=frozenset({'stand'}))\n"
        "print('ok')"
    )
    result = subprocess.run(
        [sys.executable, "-S", "-E", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stdout.strip() == "ok", result.stderr
