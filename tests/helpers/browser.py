"""A page in a headless Chromium, with what it complained of and asked for."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from helpers.places import ROOT

ARTIFACTS = ROOT / "test-artifacts"
"""Where screenshots stay after the tests."""
NAMES = "chromium", "chromium-browser", "google-chrome"
OPTIONS = [
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
VIEWS: dict[str, dict[str, Any]] = {
    "light": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "light"},
    "dark": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "dark"},
    "phone": {
        "viewport": {"width": 390, "height": 844},
        "color_scheme": "dark",
        "is_mobile": True,
        "has_touch": True,
        "device_scale_factor": 2,
    },
}


@dataclass
class Opened:
    """A page whose figures are drawn."""

    page: Any
    errors: list[str] = field(default_factory=list)
    """Of the console and of scripts, dialogs included."""
    requests: list[str] = field(default_factory=list)
    """Everything but the page itself and data within it."""


@contextmanager
def chromium() -> Iterator[Any]:
    """The browser, with a profile of its own; the test is skipped where it is missing."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not here; pip install 'carm-kin[test]'")
    path = next((found for name in NAMES if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no chromium is installed here; apt-get install chromium")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=OPTIONS)
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser: Any, path: Path, view: str, before: str = "") -> Iterator[Opened]:
    """The page at ``path`` in one of the `VIEWS`, from the first request on; the script ``before`` runs first."""
    context = browser.new_context(**VIEWS[view], offline=True)
    context.add_init_script(before)
    found = Opened(context.new_page())
    own = path.as_uri()

    def asked(request: Any) -> None:
        if request.url != own and not request.url.startswith(("data:", "blob:")):
            found.requests.append(request.url)

    def said(message: Any) -> None:
        if message.type == "error":
            found.errors.append(message.text)

    def popped_up(dialog: Any) -> None:
        found.errors.append(f"dialog: {dialog.message}")
        dialog.dismiss()

    found.page.on("request", asked)
    found.page.on("console", said)
    found.page.on("pageerror", lambda error: found.errors.append(str(error)))
    found.page.on("dialog", popped_up)
    found.page.goto(own)
    found.page.locator("html[data-drawn=true]").wait_for(state="attached", timeout=60_000)
    try:
        yield found
    finally:
        context.close()
