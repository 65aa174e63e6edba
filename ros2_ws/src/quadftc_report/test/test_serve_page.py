"""The page without a browser: what it asks of a log, the stages it shows, what its forms do."""

from __future__ import annotations

import asyncio
import re
import struct
import zipfile
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path

import httpx
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from quadftc_bags.bag import BagError
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection import diagnosis
from quadftc_replay.inspection import inspect as tests
from quadftc_replay.readers import read_log
from quadftc_report.serve.app import make_app, question_of
from quadftc_report.serve.job import STAGES, stage_of
from quadftc_report.serve.jobs import Job, Jobs

TOKEN = "token"


def telemetry_of_two() -> bytes:
    parts: list[bytes] = []
    for k in range(20):
        for system in (1, 7):
            link = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
            message = mavlink.MAVLink_attitude_message(100 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            parts.append(struct.pack(">Q", 1_700_000_000_000_000 + 100_000 * k) + message.pack(link))
    return b"".join(parts)


def blackbox_of_three() -> bytes:
    return 3 * b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n"


def write(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def archive_of_two(path: Path) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("a.bbl", "b.bbl"):
            archive.writestr(name, blackbox_of_three())
    return path


def asked(path: Path, **told) -> tuple[str, tuple[str, ...], list[str]]:
    """What the page asks of a log: its text, the fields, and the choices."""
    with pytest.raises(BagError) as error:
        read_log(path)
    message = str(error.value).replace(f"{path}: ", "")
    now = datetime.now(timezone.utc)
    question = question_of(Job(id="1", name="log", received=now, state="failed", message=message, **told))
    return question.text, question.fields, [f"{question.option} {value}" for value, _ in question.choices]


def test_page_asks_what_the_readers_ask(tmp_path):
    path = write(tmp_path / "log", telemetry_of_two())
    assert asked(path) == ("2 vehicles", (), ["system 1", "system 7"])
    write(path, blackbox_of_three())
    assert asked(path) == ("3 logs in the file", (), ["log 1", "log 2", "log 3"])
    assert asked(archive_of_two(path)) == ("2 logs in the archive", (), ["log 1", "log 2"])
    write(path, b"t,x,y,z\n0,1,2,3\n")
    text = "a text file, perhaps a table, whose columns a mapping explains"
    assert asked(path) == (text, ("mapping",), [])


def test_page_asks_nothing_of_what_is_no_log(tmp_path):
    text, fields, choices = asked(write(tmp_path / "manual.pdf", b"%PDF-1.7"))
    assert text.startswith("a PDF document; expected a log of one of the formats")
    assert (fields, choices) == ((), [])


def test_what_was_told_in_vain_can_be_told_anew(tmp_path):
    _, fields, _ = asked(write(tmp_path / "manual.pdf", b"%PDF-1.7"), log=2)
    assert fields == ("log",)


def test_stages_are_those_that_the_judgement_passes(tmp_path, monkeypatch):
    shares, entered = [0.0], dict[str, str]()

    def entering(module, name: str) -> None:
        function = getattr(module, name)

        def enter(*arguments):
            entered[name] = stage_of(shares[-1])
            return function(*arguments)

        monkeypatch.setattr(module, name, enter)

    time = np.arange(0.0, 5.0, 0.01)
    log = FlightLog(path=tmp_path, format="test", gyros={"": Signal(time, np.zeros((len(time), 3)))})
    monkeypatch.setattr(diagnosis, "read_bounded", lambda *_: log)
    entering(diagnosis, "read_bounded")
    entering(tests, "prepare")
    entering(tests, "judge_rotors")
    diagnosis.diagnose_log(tmp_path, diagnosis.DiagnosisOptions(), shares.append)
    assert list(entered.values()) == list(STAGES[:3])


@pytest.fixture
def jobs(tmp_path, monkeypatch) -> Jobs:
    async def run(_self, job: Job) -> str:
        return "" if job.log else "2 logs in the file; choose one with --log: 1 (3 MB), 2 (4 MB)"

    monkeypatch.setattr(Jobs, "_run", run)
    return Jobs(tmp_path)


class Page:
    """A browser without a screen."""

    def __init__(self, jobs: Jobs) -> None:
        self.jobs, self.loop = jobs, asyncio.new_event_loop()
        transport = httpx.ASGITransport(make_app(jobs, TOKEN))
        who = {"Authorization": f"Bearer {TOKEN}"}
        self.client = httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", headers=who)

    def get(self, *arguments, **others) -> httpx.Response:
        return self.loop.run_until_complete(self.client.get(*arguments, **others))

    def post(self, *arguments, **others) -> httpx.Response:
        """Post, and wait until all logs are judged."""

        async def post() -> httpx.Response:
            response = await self.client.post(*arguments, **others)
            await asyncio.gather(*self.jobs._tasks.values())
            return response

        return self.loop.run_until_complete(post())


@pytest.fixture
def page(jobs) -> Iterator[Page]:
    made = Page(jobs)
    yield made
    made.loop.run_until_complete(made.client.aclose())
    made.loop.close()


def cards(page: Page) -> list[str]:
    return re.findall(r"<article.*?</article>", page.get("/list").text, re.DOTALL)


def test_forms_of_a_card_do_what_they_say(page, jobs):
    key = page.post("/logs", content=b"log", headers={"X-Name": "%3Cb%3Eflight"}).json()["id"]
    [card] = cards(page)
    assert "? one answer needed" in card
    assert "<b>" not in card
    buttons = re.findall(r'<button name="log" value="(\d)">(.*?)</button>', card)
    assert buttons == [("1", "Log 1 (3 MB)"), ("2", "Log 2 (4 MB)")]
    [action] = set(re.findall(r'action="(/logs/[^"]*/choice)"', card))
    assert page.post(action, json={"log": "2"}).status_code == 204
    [card] = cards(page)
    assert "; log 2" in card
    assert "? one answer needed" in card, "no verdict was written, and the choice can be changed"
    assert re.search(r'name="log" min="1" value="2"', card)
    assert page.post(action, json={"log": ""}).status_code == 204
    page.post(action, json={"mapping": "[time]"})
    assert (jobs.all()[0].log, jobs.all()[0].mapping) == (0, "[time]")
    page.post(action, json={"log": "1"})
    assert jobs.all()[0].mapping == "[time]", "what a form does not ask stays"
    assert page.post(action, json={"system": "256"}).status_code == 422
    page.post(f"/logs/{key}/remove")
    assert cards(page) == []


def test_list_is_sent_again_only_if_it_changed(page):
    tag = page.get("/list").headers["ETag"]
    assert page.get("/list", headers={"If-None-Match": tag}).status_code == 304
    page.post("/logs", content=b"log", headers={"X-Name": "log"})
    assert page.get("/list", headers={"If-None-Match": tag}).status_code == 200


def test_page_names_the_button_and_loads_nothing(page):
    text = page.get("/").text
    assert "Plotly.newPlot" not in text
    assert not re.search(r'(?:src|href)="https?:', text)
    assert re.search(r'<button type="button"[^>]* id="choose">Choose files</button>', text)
    assert 'aria-label="Flight logs"' in text
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'")
