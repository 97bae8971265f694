"""The origin of a result is told as git tells it (the oracle), and as the version where there is no source tree."""

from __future__ import annotations

import shutil
import subprocess
from importlib import metadata
from pathlib import Path

import pytest

from telewide.origin import source_state

needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
VERSION = f"version {metadata.version('telewide')}"


def git(root: Path, *words: str) -> str:
    names = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
    return subprocess.run(["git", "-C", root, *names, *words], check=True, capture_output=True, text=True).stdout


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A source tree with one file and one commit."""
    git(tmp_path, "init", "--quiet")
    (tmp_path / "code.py").write_text("a = 1\n")
    git(tmp_path, "add", "code.py")
    git(tmp_path, "commit", "--quiet", "--message", "first")
    git(tmp_path, "tag", "v1")
    return tmp_path


@needs_git
def test_a_source_tree_is_named_by_its_commit(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_DIR", str(tree / "elsewhere"))  # as in a hook of another repository
    told = source_state(root=tree)
    monkeypatch.delenv("GIT_DIR")
    assert told == git(tree, "rev-parse", "HEAD").strip()


@needs_git
def test_a_changed_source_tree_is_told_from_its_commit(tree: Path) -> None:
    (tree / "code.py").write_text("a = 2\n")
    assert source_state(root=tree) == f"{git(tree, 'rev-parse', 'HEAD').strip()}-dirty"


@needs_git
def test_a_folder_inside_another_tree_has_the_version(tree: Path) -> None:
    (tree / "installed").mkdir()
    assert source_state(root=tree / "installed") == VERSION


def test_what_git_cannot_read_has_the_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".git").write_text("nothing\n")
    assert source_state(root=tmp_path) == VERSION
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / ".git").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path))  # without git
    assert source_state(root=tmp_path / "other") == VERSION
