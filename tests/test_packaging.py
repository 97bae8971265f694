"""What is shipped: build the sdist, the wheel from the sdist, install it, and run it away from the checkout."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
SHIPPED = "telewide/_shipped/"


def run(*command: str | Path, cwd: Path) -> str:
    """Standard output of a command that must succeed."""
    environment = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "PYTHONHOME"}}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def tracked(repo: Path) -> dict[str, bytes]:
    """Content of the data files under version control, by their path."""
    if not (repo / ".git").exists() or shutil.which("git") is None:
        pytest.skip("not a git checkout: nothing to compare the wheel with")
    names = run("git", "ls-files", "calib", "pipelines", cwd=repo).splitlines()
    return {name: (repo / name).read_bytes() for name in names}


@pytest.fixture(scope="module")
def built(repo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the sdist and the wheel that was built from it."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, repo, cwd=folder)
    return folder


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    return next(built.glob("*.whl"))


@pytest.fixture(scope="module")
def fresh_bin(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``bin`` of a fresh environment with the wheel; its dependencies are borrowed from this environment."""
    home = tmp_path_factory.mktemp("fresh")
    run(sys.executable, "-m", "venv", "--without-pip", home, cwd=home)
    python = home / "bin/python"
    pip = (sys.executable, "-m", "pip", "--python", python)
    run(*pip, "install", "--quiet", "--no-deps", "--no-index", wheel, cwd=home)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=home).strip())
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return home / "bin"


def test_wheel_ships_exactly_the_tracked_data(wheel: Path, tracked: dict[str, bytes]) -> None:
    with zipfile.ZipFile(wheel) as archive:
        shipped = {
            name.removeprefix(SHIPPED): archive.read(name) for name in archive.namelist() if name.startswith(SHIPPED)
        }
    assert shipped == tracked
    assert any(name.startswith("pipelines/") for name in shipped)


def test_wheel_holds_the_package_and_nothing_else(wheel: Path, repo: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    modules = {name for name in names if name.endswith(".py")}
    assert modules == {path.relative_to(repo).as_posix() for path in (repo / "telewide").rglob("*.py")}
    templates = {path.relative_to(repo).as_posix() for path in (repo / "telewide/pages/templates").iterdir()}
    assert templates
    assert templates <= set(names)
    assert "telewide/py.typed" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"telewide"}
    with zipfile.ZipFile(wheel) as archive:
        weights = archive.getinfo("telewide/weights/box.safetensors")
    assert weights.file_size < 12_000_000
    assert wheel.stat().st_size - weights.compress_size < 5_000_000


def test_sdist_holds_what_the_wheel_needs(built: Path) -> None:
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        tops = {Path(name).parts[1] for name in archive.getnames() if len(Path(name).parts) > 1}
    assert {"telewide", "calib", "pipelines", "pyproject.toml", "README.md", "LICENSE"} <= tops


def test_sdist_holds_what_its_readme_speaks_of(built: Path, repo: Path) -> None:
    """Every link of README and docs, what `make` needs, and the photos of the demo."""
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        names = {Path(*Path(name).parts[1:]).as_posix() for name in archive.getnames()}
    pages = [repo / "README.md", repo / "CONTRIBUTING.md", *(repo / "docs").glob("*.md")]
    linked = {
        ((page.parent / link.partition("#")[0]).resolve()).relative_to(repo.resolve()).as_posix()
        for page in pages
        for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8"))
    }
    needed = {"Makefile", "constraints.txt", "tests/conftest.py", "examples/phone/boards/000/tele.jpg"}
    folders = {parent.as_posix() for name in names for parent in Path(name).parents}
    assert (linked | needed) - names - folders == set()
    assert next(built.glob("*.tar.gz")).stat().st_size < 27_000_000


def test_fresh_environment_runs_it(fresh_bin: Path, repo: Path, tmp_path: Path) -> None:
    script = "import telewide; print(telewide.__version__, telewide.__file__)"
    version, file = run(fresh_bin / "python", "-c", script, cwd=tmp_path).split(maxsplit=1)
    assert Path(file).is_relative_to(fresh_bin.parent)
    assert not Path(file).is_relative_to(repo)
    assert version in run(fresh_bin / "telewide", "--version", cwd=tmp_path)
    assert "Usage" in run(fresh_bin / "python", "-m", "telewide", "--help", cwd=tmp_path)


def test_fresh_environment_finds_the_shipped_data(fresh_bin: Path, tmp_path: Path, tracked: dict[str, bytes]) -> None:
    script = (
        "from telewide.assets import find_asset, list_assets\n"
        "for kind in ('calib', 'pipelines'):\n"
        "    for name in list_assets(kind): print(kind, name, find_asset(kind, name))"
    )
    found = [line.split(maxsplit=2) for line in run(fresh_bin / "python", "-c", script, cwd=tmp_path).splitlines()]
    assert sorted(f"{kind}/{name}.yaml" for kind, name, _ in found) == sorted(n for n in tracked if n.endswith(".yaml"))
    assert all(Path(path).is_relative_to(fresh_bin.parent) for _, _, path in found)


def test_lower_bounds_are_constraints_that_pip_reads(repo: Path) -> None:
    """`make test-minima` runs quick tests with these versions."""
    printed = run(sys.executable, repo / ".ci/minima", cwd=repo).splitlines()
    project = tomllib.loads((repo / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    of_files = [line for name in ("exr", "heif", "mesh") for line in project["optional-dependencies"][name]]
    names = [re.split(r"[>=<]", requirement)[0] for requirement in (*project["dependencies"], *of_files)]
    assert [line.partition("==")[0] for line in printed] == names
    assert all(re.fullmatch(r"[\w.-]+==[0-9][\w.]*", line) for line in printed)


def test_constraints_name_every_package_of_the_extras(repo: Path) -> None:
    """README installs the extras with these versions too."""
    project = tomllib.loads((repo / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*project["dependencies"], *(line for extra in project["optional-dependencies"].values() for line in extra)]
    held = {line.partition("==")[0].lower() for line in (repo / "constraints.txt").read_text().splitlines()}
    assert {re.split(r"[>=<\[]", requirement)[0].lower() for requirement in asked} - held == set()
    assert "setuptools" in held  # torch asks for it
