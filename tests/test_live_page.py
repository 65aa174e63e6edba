"""quadftc live: what the page is told and shows, and one flight in a real browser."""

from __future__ import annotations

import asyncio
import contextlib
import re
import signal
import socket
import subprocess
import sys
import threading

import httpx
import numpy as np
import pytest
from browser import start_browser
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message

from node_bench import NodeBench, imu_message
from quadftc_bags.bag import read_bag
from quadftc_cli.live import LiveGraph
from quadftc_cli.live_page import charts
from quadftc_cli.live_page.commander import Commander
from quadftc_cli.live_page.feed import Feed, Flown, Frame, receive
from quadftc_cli.live_page.flying import (
    Wish,
    fly_live,
    follow,
    page_of,
    page_of_running,
    plan_of,
    scenario_of,
    serving,
    vehicles_of,
)
from quadftc_cli.live_page.picture import Picture, amount
from quadftc_cli.live_page.server import picture_of
from quadftc_control.controller_node import ControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_flight.live_run import live_run
from quadftc_model.samples import FAULTY, ComponentFault, DiagnosisReport, level_sample
from quadftc_model.vehicle import load_vehicle
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.scheduling import ORDINARY
from quadftc_ros.wire import ImuWire, VectorWire
from quadftc_sim.fault_injector_node import FaultInjectorNode

SECOND = 1_000_000_000  # ns
HOVER = Wish("", "", "", False, False, "", 0.0, None, "")
RUN = "import sys, typer; from quadftc_cli.main import guarded; from quadftc_cli.commands.live import live; "
RUN += "app = typer.Typer(); app.command()(live); sys.exit(guarded(sys.argv[1:], app))"
PATIENCE = 60.0  # s
PAGE = Flown("", "the first", "qball_x4", "test_stand")


@pytest.fixture
def channel():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        yield ours, theirs


def test_page_gets_the_last_of_each_topic_and_the_flight_never_waits(channel):
    feed = Feed(channel[0], "drone1", "test_stand")
    assert feed.tap("/drone1/imu/corrected") is not None
    assert feed.tap("/drone1/plant/imu") is None
    assert feed.tap("/drone1/plant/odometry") is None  # of free flight
    imu, status = feed.tap("/drone1/imu/data"), feed.tap("/drone1/control/status")
    imu(b"first")
    imu(b"last")
    feed.tap("/diagnostics")(b"one")
    feed.tap("/diagnostics")(b"two")
    status(b"torque is out")
    frame = receive(channel[1])
    assert frame.last == {"imu/data": b"last", "control/status": b"torque is out"}
    assert frame.diagnostics == [b"one", b"two"]
    for _ in range(2000):  # nobody takes them
        imu(bytes(1000))
        feed.send()
    channel[0].close()
    feed.send()
    while (frame := receive(channel[1])) is not None:
        assert set(frame.last) <= {"imu/data"}


def shown(report: DiagnosisReport) -> Picture:
    picture = Picture(load_vehicle("qball_x4"), "test_stand")
    picture.latest.put("diagnosis", DiagnosisWire()(report))
    return picture


def test_states_tell_faulty_ambiguous_and_unwatched_components():
    fault = ComponentFault(
        component="attitude",
        element="roll",
        kind="offset",
        state=FAULTY,
        size=0.05,
        std_dev=0.001,
        unit="rad",
        probability=0.9,
        ambiguous_with=("gyro/x",),
        onset_ns=SECOND,
    )
    states = shown(DiagnosisReport(2 * SECOND, ("attitude", "gyro"), (fault,))).states()
    assert [states["attitude"][axis].name for axis in ("roll", "pitch", "yaw")] == [
        "ambiguous",
        "healthy",
        "healthy",
    ]
    assert [states["gyro"][axis].name for axis in "xyz"] == ["ambiguous", "healthy", "healthy"]
    assert states["accelerometer"]["x"].name == "unwatched"
    assert "offset 2.86 ± 0.06 deg" in states["attitude"]["roll"].words
    certain = fault._replace(ambiguous_with=(), kind="unknown")
    state = shown(DiagnosisReport(2 * SECOND, ("attitude",), (certain,))).states()["attitude"]["roll"]
    assert (state.name, state.words) == ("faulty", "2.86 ± 0.06 deg, since 1.00 s")


@pytest.mark.parametrize(
    ("size", "std_dev", "unit", "words"),
    [
        (0.1, -1.0, "rad/s", "5.73 deg/s"),
        (0.3, 0.02, "1", "30 ± 2 %"),
        (1.0, 0.1, "m/s^2", "1.00 ± 0.10 m/s²"),
    ],
)
def test_size_is_written_for_people(size, std_dev, unit, words):
    assert amount(size, std_dev, unit) == words


def test_charts_know_the_columns_of_a_row():
    picture = Picture(load_vehicle("qball_x4"), "test_stand")
    picture.latest.put("imu/data", ImuWire()(SECOND, level_sample()))
    picture.latest.put("plant/rate", VectorWire("base_link")(SECOND, np.radians([1.0, 2.0, 3.0])))
    picture.latest.put("torque/command", VectorWire("base_link")(SECOND, np.array([4.0, 5.0, 6.0])))
    row = picture._row()
    assert row[charts.RATE_AT : charts.RATE_AT + 3] == pytest.approx([1.0, 2.0, 3.0])
    assert row[charts.MEASURED_AT : charts.MEASURED_AT + 3] == pytest.approx([0.0] * 3)
    assert row[charts.TORQUE_AT :] == [4.0, 5.0, 6.0]
    assert np.isnan(row[charts.TRUTH_AT])


def test_sliders_begin_where_the_vehicle_hovers():
    scenario = scenario_of(HOVER)
    plan = plan_of(HOVER, scenario, ORDINARY)
    assert page_of(plan, scenario).home == (0.0, 0.0, 1.5, 0.0)
    assert plan.parameters["position_controller"]["source"] == "topic"
    follows = Wish("free_circle", "", "", False, False, "500", 0.0, None, "")
    circle = plan_of(follows, scenario_of(follows), ORDINARY)
    assert "source" not in circle.parameters["position_controller"]
    assert (circle.parameters["plant"]["rate"], circle.parameters["plant"]["duration"]) == (500.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scheme": "indi"}, "--scheme: belongs to --scenario"),
        ({"scenario": "free_circle", "stand": True}, "--stand: the scenario says where it flies"),
        ({"scenario": "fre_circle"}, "did you mean 'free_circle'"),
        ({"vehicle": "x5000"}, "no vehicle 'x5000'"),
        ({"rate": "fast"}, "rate"),
    ],
)
def test_wrong_wish_is_refused(changes, words):
    with pytest.raises(ValueError, match=words) as caught:
        scenario_of(Wish(**{**vars(HOVER), **changes}))
    assert "\n" not in str(caught.value)


def test_what_flies_already_is_not_chosen_again():
    from quadftc_cli.commands.live import live

    with pytest.raises(ValueError, match="--attach: shows what flies already"):
        live(attach=True, stand=True)


@pytest.fixture
def two_vehicles():
    """Nodes of two vehicles, each in a namespace, that are served while the test talks to them."""
    over, threads = threading.Event(), []

    def serve(bench):
        while not over.is_set():
            bench._executor.spin_once(timeout_sec=0.05)

    with contextlib.ExitStack() as stack:
        benches = [stack.enter_context(NodeBench("realtime", name)) for name in ("uav1", "uav2")]
        for bench, vehicle in zip(benches, ("qball_x4", "crazyflie_2x"), strict=True):
            bench.run(FaultInjectorNode)
            for node in (ControllerNode, FaultObserverNode, ReferenceNode):
                bench.run(node, vehicle=vehicle)
            threads.append(threading.Thread(target=serve, args=(bench,)))
            threads[-1].start()
        yield benches
        over.set()
        for thread in threads:
            thread.join()


def test_page_is_attached_to_each_vehicle_that_flies(two_vehicles, channel):
    talk, frames = two_vehicles[1].talk("imu/data"), []

    def goes_on():
        talk(imu_message(SECOND + len(frames)))
        with contextlib.suppress(BlockingIOError):
            while True:
                frames.append(receive(channel[1]))
        return "imu/data" not in {topic for frame in frames for topic in frame.last}

    channel[1].setblocking(False)
    with LiveGraph() as graph:
        flown = []
        for name in vehicles_of(graph):
            graph.namespace = name
            flown.append(page_of_running(graph))
        assert [each.namespace for each in flown] == ["uav1", "uav2"]
        assert [each.parts.partition(",")[0] for each in flown] == ["qball_x4", "crazyflie_2x"]
        follow(graph, channel[0], flown, goes_on)
    assert {frame.vehicle for frame in frames if "imu/data" in frame.last} == {1}
    assert {frame.vehicle for frame in frames} == {0, 1}


def test_fault_goes_to_the_vehicle_that_the_page_shows(two_vehicles):
    commanders = [Commander(name) for name in ("uav1", "uav2")]
    for commander in reversed(commanders):
        injected = asyncio.run(commander.inject("bias axis=roll value=8deg"))
        assert injected.number == 1, "each injector counts its own"
    for commander in commanders:
        commander.close()


@pytest.fixture(scope="module")
def two_pages():
    flown = [PAGE, PAGE._replace(namespace="b", parts="the second")]
    with serving(0, flown, False) as (_, address, _stop):
        yield address


def test_vehicle_does_not_show_what_the_nodes_of_another_report():
    flown = [PAGE, PAGE._replace(namespace="uav2")]
    said = {"plant": "250", "uav2/plant": "500", "driver": "1000", "hw/driver": "2000"}
    told = [
        DiagnosticStatus(name=f"{node}: timing", values=[KeyValue(key="rate_hz", value=rate)])
        for node, rate in said.items()
    ]
    frame = Frame({}, [serialize_message(DiagnosticArray(status=told))])
    for each, rate in zip(flown, ("250", "500"), strict=True):
        picture = picture_of(each, *flown)
        picture.take(frame)
        assert picture.value("plant", "timing", "rate_hz") == rate
        assert picture.value("hw/driver", "timing", "rate_hz") == "2000"
    alone = picture_of(flown[1])
    alone.take(frame)
    assert alone.value("driver", "timing", "rate_hz") == "1000"


def test_heading_names_the_observer_that_flies_now():
    picture = Picture(load_vehicle("qball_x4"), "test_stand")
    begun = "qball_x4, observer isolating, controller ismc"
    assert picture.parts(begun) == begun
    told = DiagnosticStatus(name="fault_observer: observer", message="threshold has no states")
    picture.take(Frame({}, [serialize_message(DiagnosticArray(status=[told]))]))
    assert picture.parts(begun) == "qball_x4, observer threshold, controller ismc"


@pytest.mark.parametrize(
    ("query", "status", "words"),
    [
        ("", 200, "the first"),
        ("?vehicle=1", 200, "the second"),
        ("?vehicle=7", 200, "the first"),
        ("?vehicle=x", 422, None),
    ],
)
def test_address_says_which_vehicle_is_shown(two_pages, query, status, words):
    base, token = two_pages.split("?token=")
    answer = httpx.get(base + query, headers={"Authorization": f"Bearer {token}"}, timeout=PATIENCE)
    assert answer.status_code == status
    assert [each for each in ("the first", "the second") if each in answer.text] == [words] * (status == 200)


def test_port_that_is_taken_is_refused_before_anything_flies():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ValueError, match=f"--port {port}: Address already in use"):
            fly_live(HOVER, port, False, ("sleep", 0, ()))


@pytest.fixture
def flown(tmp_path):
    """The address of a page, the process that flies, and the bag that it records."""
    record = tmp_path / "bag"
    command = [sys.executable, "-c", RUN, "--stand", "--no-browser", "--port", "0", "--record", record]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, umask=0)
    assert process.stderr is not None
    lines = iter(process.stderr.readline, "")
    address = next((found[1] for line in lines if (found := re.match(r"page: +(http\S+)", line))), None)
    assert address is not None
    yield address, process, record
    if process.poll() is None:
        process.kill()
    process.communicate()


@pytest.mark.slow
def test_fault_is_injected_by_its_button_and_found(flown):
    """One flight in a browser: injected, found, cleared; the page loads nothing from elsewhere."""
    from selenium.webdriver.support.wait import WebDriverWait

    address, process, record = flown
    own = address.partition("?")[0]
    with start_browser("THE PAGE OF QUADFTC LIVE", "--enable-unsafe-swiftshader") as browser:
        waits = WebDriverWait(browser, PATIENCE)

        def chip(state: str) -> str:
            return f'[data-element="attitude/roll"][data-state="{state}"]'

        def await_one(selector: str):
            return waits.until(lambda each: each.find_elements("css selector", selector), selector)[0]

        browser.get(address)
        await_one(chip("healthy"))
        await_one('[data-fault="bias axis=roll value=8deg"]').click()
        await_one(chip("faulty"))
        findings = browser.find_element("css selector", '[data-show="findings"]')
        waits.until(lambda _: re.search(r"attitude roll: offset [78]\.\d+ .* deg, since", findings.text))
        await_one('[data-clear="all"]').click()
        await_one(chip("healthy"))
        assert browser.execute_script("return document.querySelectorAll('.chart canvas').length") == 4
        names = "return performance.getEntriesByType('resource').map(each => each.name)"
        loaded = browser.execute_script(names)
        assert [name for name in loaded if not name.startswith((own, "data:", "blob:"))] == []
        assert [each for each in browser.get_log("browser") if each["level"] == "SEVERE"] == []
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 0
    written = [record, *record.rglob("*")]
    assert len(written) > 1
    assert [path for path in written if path.stat().st_mode & 0o077] == [], "the user's alone"
    assert [event[:2] for event in live_run(read_bag(record)).events] == [("roll", "step")]
