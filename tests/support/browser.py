"""A real browser for tests of pages; without one they are skipped, and say so."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)


def programs(what: str) -> tuple[str, str]:
    """The browser and its driver."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    driver = shutil.which("chromedriver")
    if browser is None or driver is None:
        pytest.skip(
            f"{what} WAS NOT TESTED IN A BROWSER: Chromium or chromedriver is missing and could not be"
            " installed (Debian: sudo apt-get install chromium chromium-driver)"
        )
    return browser, driver


@contextmanager
def start_browser(what: str, *more: str) -> Iterator:
    """Start the browser with ``more`` arguments; ``what`` is tested, for the message if there is none."""
    from selenium.webdriver import Chrome, ChromeOptions, ChromeService

    program, driver = programs(what)
    options = ChromeOptions()
    options.binary_location = program
    for argument in (*ARGUMENTS, *more):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    with Chrome(options=options, service=ChromeService(driver)) as started:
        yield started
