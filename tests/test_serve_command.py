"""The local page: takes logs of bounded size, judges them, stays in its folder, answers its own pages."""

from __future__ import annotations

import asyncio
import json
import queue
import subprocess
import sys
import time
import webbrowser
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from browser import start_browser

from quadftc_report.serve.jobs import Choice, Jobs, safe_name
from quadftc_report.serve.local import browser_at

PARENTS = Path(__file__).resolve().parents
DATA = next((parent / "shared/data" for parent in PARENTS if (parent / "shared/data").is_dir()), None)
LOG = None if DATA is None else DATA / "crazyflie/crazypad/controller_data-normal_flight-E8_log00"
RUN = "from pathlib import Path; from quadftc_cli.commands.serve import serve; import sys; "
RUN += "serve(Path(sys.argv[1]), 0, 2, 1, False)"
PATIENCE = 60.0  # s


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("served") / "folder"


@pytest.fixture(scope="module")
def address(folder) -> Iterator[str]:
    """A page with a folder of its own, and logs of at most 1 MiB."""
    process = subprocess.Popen([sys.executable, "-c", RUN, folder], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = process.stdout.readline()
    yield line.split()[-1]
    process.terminate()
    process.wait(10)
    process.stdout.close()


@pytest.fixture(scope="module")
def client(address) -> Iterator[httpx.Client]:
    """One that has the token, as a script would."""
    base, _, token = address.partition("/?token=")
    who = {"Authorization": f"Bearer {token}"}
    with httpx.Client(base_url=base, headers=who, timeout=PATIENCE) as made:
        yield made


def post(client: httpx.Client, name: str, content) -> httpx.Response:
    return client.post("/logs", content=content, headers={"X-Name": name})


def await_end(folder: Path, key: str) -> dict:
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        job = json.loads((folder / key / "job.json").read_text())
        if job["state"] in ("done", "failed"):
            return job
        time.sleep(0.1)
    raise AssertionError("not judged in time")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("flight.ulg", "flight.ulg"),
        ("../../etc/passwd", "passwd"),
        ("C:\\logs\\a b.BIN", "a_b.BIN"),
        ("..", "log"),
        (".bashrc", "bashrc"),
        ("a\0b\n/..hidden; rm -rf", "hidden_rm_-rf"),
        ("", "log"),
        ("x" * 300 + ".mcap", "x" * 75 + ".mcap"),
    ],
)
def test_name_of_a_file_becomes_a_plain_one(name, expected):
    assert safe_name(name) == expected


@pytest.fixture(scope="module")
def judged(client, folder) -> str:
    """A log that was judged."""
    if LOG is None:
        pytest.skip("no recorded logs beside the repository (shared/data)")
    key = post(client, LOG.name, LOG.read_bytes()).json()["id"]
    await_end(folder, key)
    return key


def test_log_is_judged_and_its_verdict_handed_out(client, folder, judged):
    assert LOG is not None
    key, job = judged, await_end(folder, judged)
    assert (job["state"], job["name"], job["size"]) == ("done", LOG.name, LOG.stat().st_size)
    response = client.get(f"/logs/{key}/verdict.json")
    assert response.json()["log"] == LOG.name
    picture = client.get(f"/logs/{key}/picture.svg")
    assert picture.headers["Content-Type"] == "image/svg+xml"
    assert "</svg>" in picture.text
    assert "default-src 'none'" in response.headers["Content-Security-Policy"]


def test_file_that_is_no_log_fails_with_the_reason(client, folder):
    key = post(client, "%2e%2e%2f%2e%2e%2fnotes.txt", b"#!/bin/sh\ntouch ran\n").json()["id"]
    job = await_end(folder, key)
    assert (job["state"], job["name"]) == ("failed", "notes.txt")
    assert "expected a log of one of the formats" in job["message"]
    assert sorted(path.name for path in (folder / key).rglob("*")) == ["in", "job.json", "notes.txt"]
    for path in (f"{key}/job.json", f"{key}/in/notes.txt", f"{key}/..%2f{key}%2fjob.json", "x/verdict.json"):
        assert client.get(f"/logs/{path}").status_code == 404, path


MAPPING = """
[time]
column = "t"
[[signal]]
quantity = "gyro"
columns = ["x", "y", "z"]
unit = "rad/s"
"""


def test_table_is_judged_by_the_mapping_that_is_chosen(tmp_path):
    noise = np.random.default_rng(1).normal(scale=0.01, size=(2000, 3))
    rows = "".join(f"{0.01 * k:.2f},{x},{y},{z}\n" for k, (x, y, z) in enumerate(noise))

    async def content():
        yield f"t,x,y,z\n{rows}".encode()

    async def judge():
        jobs = Jobs(tmp_path)
        job = await jobs.receive("flight.csv", content())
        await asyncio.gather(*jobs._tasks.values())
        assert "perhaps a table, whose columns --mapping FILE explains" in job.message
        jobs.choose(job.id, Choice(mapping=MAPPING))
        await asyncio.gather(*jobs._tasks.values())
        assert job.verdict is not None, job.message
        assert job.verdict.judged == ("gyro",)

    asyncio.run(judge())


@pytest.fixture(scope="module")
def browser():
    with start_browser("THE PAGE OF QUADFTC SERVE") as started:
        yield started


def wait_for(browser, script: str):
    from selenium.webdriver.support.wait import WebDriverWait

    return WebDriverWait(browser, PATIENCE).until(lambda _: browser.execute_script(script), script)


CARDS = "[...document.querySelectorAll('[data-state]')]"
TEXTS = f"return {CARDS}.map(each => each.dataset.state + each.innerText)"
DROP = """
const carried = new DataTransfer();
carried.items.add(new File(["no log"], "<b>dropped.txt"));
for (const type of ["dragover", "drop"]) {
  const event = new DragEvent(type, {dataTransfer: carried, bubbles: true, cancelable: true});
  document.querySelector("h1").dispatchEvent(event);
}
"""


@pytest.mark.usefixtures("judged")
def test_in_a_browser_logs_are_dropped_and_verdicts_read_and_removed(
    browser, address, folder, tmp_path, monkeypatch
):
    from selenium.webdriver.common.by import By

    assert LOG is not None
    own = address.partition("?")[0]
    large, other = tmp_path / "large", tmp_path / "other.txt"
    large.write_bytes(bytes((1 << 20) + 1))
    other.write_text("no log")
    before = len(list(folder.iterdir()))
    browser.set_window_size(500, 800)
    # by the file by which the command opens it: for a browser that is a page of another site
    opened = queue.SimpleQueue[str]()
    monkeypatch.setattr(webbrowser, "open", opened.put)
    with browser_at(address, tmp_path):
        browser.get(opened.get(timeout=PATIENCE))
        wait_for(browser, f"return location.href === '{own}'")
    wait_for(browser, f"return {CARDS}.length === {before}")
    browser.find_element(By.ID, "files").send_keys(f"{other}\n{large}")
    ended = f"{CARDS}.filter(each => ['done', 'failed'].includes(each.dataset.state)).length"
    wait_for(browser, f"return {ended} === {before + 1}")
    browser.execute_script(DROP)  # a second time, and anywhere on the page
    wait_for(browser, f"return {ended} === {before + 2}")
    texts = browser.execute_script(TEXTS)
    assert any(text.startswith("done") and LOG.name in text and "Open the report" in text for text in texts)
    assert any(
        text.startswith("failed") and "_dropped" in text and "expected a log" in text for text in texts
    )
    assert len(list(folder.iterdir())) == before + 2  # the large one was not taken
    assert "larger than 1 MiB" in browser.find_element(By.ID, "sending").text
    assert browser.execute_script(
        "const { scrollWidth } = document.documentElement; return scrollWidth <= innerWidth"
    )
    # the list is there again after a reload; what is removed is gone
    browser.refresh()
    wait_for(browser, f"return {CARDS}.length === {before + 2}")
    failed = browser.find_element(By.CSS_SELECTOR, "[data-state=failed]")
    failed.find_element(By.XPATH, ".//button[.='Remove']").click()
    wait_for(browser, f"return {CARDS}.length === {before + 1}")
    assert len(list(folder.iterdir())) == before + 1
    # the report draws, although it may load nothing
    browser.find_element(By.LINK_TEXT, "Open the report").click()
    wait_for(browser, "return document.documentElement.dataset.figures === 'drawn'")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
    asked = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    requests = [each["params"]["request"] for each in asked if each["method"] == "Network.requestWillBeSent"]
    assert all(request["url"].startswith((own, "data:", "blob:", "file:")) for request in requests)
