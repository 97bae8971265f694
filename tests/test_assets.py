"""Assets: what is found where, and what an unknown name says."""

from __future__ import annotations

from pathlib import Path

import pytest

from telewide import assets
from telewide.assets import find_asset, list_assets
from telewide.errors import UsageError


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package folder with a shipped copy, a checkout around it, and a user's folder as the current one."""
    for folder in ("user/pipelines", "site/telewide/_shipped/pipelines", "site/pipelines"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.setattr(assets, "_PACKAGE", tmp_path / "site/telewide")
    monkeypatch.chdir(tmp_path / "user")
    return tmp_path


def test_every_listed_asset_is_found() -> None:
    assert "boards/chessboard_9x6" in list_assets("calib")
    for kind in ("calib", "pipelines"):
        for name in list_assets(kind):
            assert find_asset(kind, name).is_file()


def test_order_explicit_user_shipped_checkout(installed: Path) -> None:
    for place in ("site/pipelines", "site/telewide/_shipped/pipelines", "user/pipelines"):
        (installed / place / "quick.yaml").touch()
        assert find_asset("pipelines", "quick") == installed / place / "quick.yaml"
    (installed / "user/quick.yaml").touch()
    assert find_asset("pipelines", "quick.yaml") == Path("quick.yaml")
    assert find_asset("pipelines", "quick") == installed / "user/pipelines/quick.yaml"
    assert list_assets("pipelines") == ("quick",)


def test_unknown_name_says_the_nearest(installed: Path) -> None:
    (installed / "site/pipelines/default.yaml").touch()
    (installed / "site/pipelines/quick.yaml").touch()
    with pytest.raises(UsageError, match="known: default, quick") as caught:
        find_asset("pipelines", "quik")
    assert caught.value.hint == "did you mean quick?"
    with pytest.raises(UsageError, match=r"missing\.yaml"):
        find_asset("pipelines", "missing.yaml")


def test_no_folder_at_all(installed: Path) -> None:
    with pytest.raises(UsageError, match="known: none"):
        find_asset("calib", "boards/a")
