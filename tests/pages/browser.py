"""A browser without a screen, without a network, with WebGL drawn by the processor."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_ARGUMENTS = (
    *("--no-sandbox", "--enable-unsafe-swiftshader", "--disable-background-networking", "--disable-sync"),
    *("--disable-component-update", "--no-first-run", "--disable-quic"),
)


@contextmanager
def page_in_browser(path: Path, *, wh: tuple[int, int] = (1000, 900), **options: Any) -> Iterator[Any]:
    """Open a page; at the end no fault was logged and nothing was asked for but the page itself."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next((found for name in _NAMES if (found := shutil.which(name))), None)
    faults: list[str] = []
    asked: list[str] = []
    with playwright.sync_playwright() as started:
        program = program or started.chromium.executable_path  # of `playwright install chromium`, where that was done
        if not Path(program).exists():
            pytest.skip("no Chromium is installed")
        browser = started.chromium.launch(executable_path=program, args=list(_ARGUMENTS))
        page = browser.new_context(viewport={"width": wh[0], "height": wh[1]}, **options).new_page()
        page.on("console", lambda told: faults.append(told.text) if told.type == "error" else None)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        yield page
        browser.close()
    assert faults == []
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {path.as_uri()}
