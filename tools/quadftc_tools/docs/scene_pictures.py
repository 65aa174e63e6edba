# pyright: basic
"""Pictures of the 3D scene of ``quadftc live``, for flights that were flown already; takes a real browser."""

from __future__ import annotations

import io
import shutil
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import uvicorn
from fastapi import FastAPI
from PIL import Image

from quadftc_cli.live_page.commander import Commander
from quadftc_cli.live_page.feed import Frame
from quadftc_cli.live_page.page import Flown, add_page
from quadftc_cli.live_page.picture import Picture
from quadftc_flight.flight import Flight
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import level_sample
from quadftc_model.vehicle import load_vehicle
from quadftc_report.serve.local import address_of, listen
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME
from quadftc_ros.wire import ImuWire, VectorWire

ALONE = ".heading, .side, .lower, .legend { display: none } .page { display: block } .stage { height: 100vh }"
NEW_FLIGHT_NS = 1_000_000_000_000  # ns; between the stamps of two flights
SETTLE = 0.25  # s; for a frame to reach the browser
PATIENCE = 60.0  # s; for the page to be there
DRAWN = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(done))"


class SceneCamera:
    """Takes pictures of a vehicle on a test stand."""

    def __init__(self, picture: Picture, browser: Any) -> None:
        self._picture, self._browser = picture, browser
        self._imu, self._attitude, self._torque = ImuWire(), VectorWire(EARTH_FRAME), VectorWire(BASE_FRAME)
        self._flights = 0

    def take(self, flight: Flight, rows: Sequence[int]) -> Iterator[Image.Image]:
        """Return a picture of each of some rows of a flight."""
        self._flights += 1
        for row in rows:
            stamp_ns = self._flights * NEW_FLIGHT_NS + int(1e9 * flight.time[row])
            self._picture.take(Frame(self._messages(flight, row, stamp_ns), []))
            time.sleep(SETTLE)
            self._browser.execute_async_script(DRAWN)
            yield Image.open(io.BytesIO(self._browser.get_screenshot_as_png())).convert("RGB")

    def _messages(self, flight: Flight, row: int, stamp_ns: int) -> dict[str, bytes]:
        read = flight.angles[row] + flight.fault[row]
        found = {
            "plant/attitude": self._attitude(stamp_ns, flight.angles[row]),
            "torque/command": self._torque(stamp_ns, flight.torque[row]),
        }
        for topic, angles in (("imu/data", read), ("imu/corrected", read - flight.fault_estimate[row])):
            sample = level_sample()._replace(q_xyzw=quaternion_from_euler(angles))
            found[topic] = self._imu(stamp_ns, sample)
        return found


@contextmanager
def scene_camera(vehicle: str, width: int, height: int) -> Iterator[SceneCamera]:
    """Serve a page with the scene alone, open it in a browser, and close both at the end."""
    from selenium.webdriver import Chrome, ChromeOptions, ChromeService

    picture = Picture(load_vehicle(vehicle), "test_stand")
    app, commander = FastAPI(), Commander("")
    add_page(app, picture, commander, Flown("", "", vehicle, "test_stand", "", None))
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", timeout_graceful_shutdown=1))
    options = ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome") or ""
    for argument in ("--headless", "--no-sandbox", "--enable-unsafe-swiftshader", "--hide-scrollbars"):
        options.add_argument(argument)
    with listen(0) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            with Chrome(
                options=options, service=ChromeService(shutil.which("chromedriver") or "")
            ) as browser:
                size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
                browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
                browser.get(address_of(listener))
                _await_scene(browser)
                yield SceneCamera(picture, browser)
        finally:
            server.should_exit = True
            thread.join()
            commander.close()


def _await_scene(browser: Any) -> None:
    """Wait until the scene is drawn, and leave it alone on the page."""
    end = time.monotonic() + PATIENCE
    ready = "return document.querySelector('.scene:not([data-initializing]) canvas') !== null"
    while not browser.execute_script(ready):
        if time.monotonic() > end:
            raise TimeoutError(f"no scene within {PATIENCE:g} s")
        time.sleep(0.1)
    style = f"document.head.appendChild(document.createElement('style')).textContent = `{ALONE}`"
    browser.execute_script(style)
    browser.execute_script("window.dispatchEvent(new Event('resize'))")
