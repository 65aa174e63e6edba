"""quadftc live --bag: how the page plays a recorded flight, and which bags it refuses."""

from __future__ import annotations

import contextlib
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from browser import start_browser
from rclpy.qos import QoSProfile

from quadftc_bags.bag import BagError
from quadftc_bags.writer import BagWriter
from quadftc_cli.commands.live import live
from quadftc_cli.live_page import charts
from quadftc_cli.live_page.page import words_of
from quadftc_cli.live_page.player import Player, read_recorded
from quadftc_cli.live_page.server import picture_of
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.loop_run import run_loop
from quadftc_flight.scenario import parse_scenario
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import level_sample
from quadftc_ros.wire import ImuWire, VectorWire

TEXT = """
name: short
description: a hover with one fault
duration: 8 s
rate: 100 Hz
vehicle: x500
plant: {kind: free_flight}
trajectories: [{kind: hover, position: [1, 0, 2]}]
faults: [{kind: bias, axes: pitch, value: 5 deg, start: 5 s, stop: 7 s}]
schemes: {first: {observer: isolating, controller: ismc}}
"""
IMU, VECTOR = "sensor_msgs/msg/Imu", "geometry_msgs/msg/Vector3Stamped"
RUN = "import sys, typer; from quadftc_cli.main import guarded; from quadftc_cli.commands.live import live; "
RUN += "app = typer.Typer(); app.command()(live); sys.exit(guarded(sys.argv[1:], app))"
PATIENCE = 60.0  # s


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """A flight in free flight: a folder with one bag in it."""
    folder = tmp_path_factory.mktemp("flown")
    scenario = parse_scenario(TEXT, "short")
    run_loop(scenario, scenario.scheme("first"), folder, "numpy")
    return folder


def player_of(path: Path, speed: float = 1.0):
    (recorded,) = read_recorded(path)
    picture = picture_of(recorded.flown)
    return Player([recorded], [picture], speed), picture


def pitch(picture, role: str) -> float:
    return float(np.degrees(euler_from_quaternion(picture.latest.attitudes()[role])[1]))


def test_recorded_flight_shows_at_any_time_what_a_live_one_does(bag):
    player, picture = player_of(bag, speed=2.0)
    for _ in range(90):  # 3 s of the clock
        player.step(1.0 / 30.0)
    assert (player.time, picture.time) == pytest.approx((6.0, 6.0), abs=0.02)
    assert pitch(picture, "measured") - pitch(picture, "truth") == pytest.approx(5.0, abs=0.5)
    state = picture.states()["attitude"]["pitch"]
    assert (state.name, state.words.endswith("since 5.00 s")) == ("faulty", True)
    np.testing.assert_allclose(picture.latest.position(), [1.0, 0.0, 2.0], atol=0.1)
    times = [row[0] for row in picture.rows]
    assert times == sorted(times)
    assert (times[0], times[-1]) == pytest.approx((0.0, 6.0), abs=0.2)


def test_going_back_leaves_nothing_of_what_came_later(bag):
    player, picture = player_of(bag)
    player.wanted = 6.0
    player.step(0.0)
    assert picture.states()["attitude"]["pitch"].name == "faulty"
    begun = picture.count
    player.wanted = 4.0
    player.step(0.0)
    assert (player.time, picture.time) == pytest.approx((4.0, 4.0), abs=0.02)
    assert picture.states()["attitude"]["pitch"].name == "healthy"
    assert picture.rows[-1][0] <= 4.0
    assert picture.count - begun == len(picture.rows), "the page sends all rows again"


def test_recorded_flight_pauses_ends_and_begins_again(bag):
    player, _ = player_of(bag)
    player.toggle()
    player.step(1.0)
    assert (player.time, player.playing) == (0.0, False)
    player.toggle()
    player.step(100.0)
    assert (player.time, player.playing) == (player.duration, False)
    assert player.duration == pytest.approx(8.0, abs=0.05)
    player.toggle()
    player.step(0.0)
    assert (player.time, player.playing) == (0.0, True)
    player.wanted = -1.0
    player.step(0.0)
    assert player.time == 0.0


def test_page_of_a_recorded_flight_says_what_flew_and_failed(bag):
    (recorded,) = read_recorded(bag)
    flown = recorded.flown
    assert (flown.title, flown.plant) == ("a hover with one fault", "free_flight")
    assert flown.parts == "x500, observer isolating, controller ismc, 100 Hz, recorded"
    assert (flown.simulated, flown.home) == (False, None), "no buttons for faults, no sliders"
    assert recorded.warnings == ()
    assert [words_of(event) for event in recorded.events] == ["5.00 to 7.00 s  attitude pitch"]
    assert words_of(FaultEvent("roll", "stuck", 1.0, 2.5, "gyro")) == "1.00 to 2.50 s  gyro x: stuck"
    assert words_of(FaultEvent("3", "loss", 1.0, 2.5, "rotor")) == "1.00 to 2.50 s  rotor 3: loss"


def write(path: Path, rows, topics=None) -> Path:
    """Write a bag of (topic, time [s], message)."""
    with BagWriter(path) as writer:
        for topic, type_name in (topics or {"/imu/data": IMU}).items():
            writer.add_topic(topic, type_name, QoSProfile(depth=10))
        for topic, time, data in rows:
            writer.write(topic, data, round(1e9 * time), round(1e9 * time))
    return path


def samples(topic: str = "/imu/data", times=(1.0, 1.5, 2.0)):
    return [(topic, time, ImuWire()(round(1e9 * time), level_sample())) for time in times]


def test_bag_of_a_bare_imu_plays_without_charts_that_stay_empty(tmp_path):
    path = write(tmp_path / "bare", samples())
    player, picture = player_of(path)
    player.step(0.6)
    assert "measured" in picture.latest.attitudes()
    assert [chart[0] for chart in charts._plan(picture)] == ["attitude", "body rate", "torque command"]
    assert read_recorded(path)[0].warnings == (f"{path}: says of no vehicle; drawn as qball_x4",)


def test_topic_of_another_type_and_what_is_no_message_are_left_out(tmp_path):
    topics = {"/imu/data": IMU, "/imu/corrected": VECTOR, "/diagnosis": "quadftc_msgs/msg/Diagnosis"}
    stamp = VectorWire("map")(1_200_000_000, np.ones(3))
    rows = [*samples(), *((topic, 1.2, stamp) for topic in topics if topic != "/imu/data")]
    player, picture = player_of(write(tmp_path / "odd", sorted(rows, key=lambda row: row[1]), topics))
    player.step(0.4)
    assert [*picture.latest.attitudes()] == ["measured"]
    assert picture.states()["gyro"]["x"].name == "unwatched"


def two_vehicles(folder: Path) -> Path:
    rows = [*samples("/a/imu/data"), *samples("/b/imu/data", (1.2, 2.0, 4.2))]
    rows += [("/b/torque/command", 2.0, VectorWire("base_link")(2_000_000_000, np.ones(3)))]
    names = {"/a/imu/data": IMU, "/b/imu/data": IMU, "/b/torque/command": VECTOR}
    return write(folder / "two", sorted(rows, key=lambda row: row[1]), names)


def test_namespace_takes_one_of_several_vehicles_alone(tmp_path):
    path = two_vehicles(tmp_path)
    (recorded,) = read_recorded(path, "b")
    assert recorded.times[-1] == pytest.approx(3.0)
    assert {topic for topic, _ in read_recorded(path, "/b/")[0].messages} == {"imu/data", "torque/command"}
    with pytest.raises(
        BagError, match=r"no message on c/imu/data .*; topics there: /a/imu/data, /b/imu/data"
    ):
        read_recorded(path, "c")


def test_all_vehicles_of_a_bag_play_at_the_same_time(tmp_path):
    vehicles = read_recorded(two_vehicles(tmp_path))
    assert [each.flown.namespace for each in vehicles] == ["a", "b"]
    pictures = [picture_of(each.flown) for each in vehicles]
    player = Player(vehicles, pictures, 1.0)
    assert player.duration == pytest.approx(3.2)
    player.step(0.9)
    assert [picture.time for picture in pictures] == pytest.approx([0.5, 0.2])
    player.wanted = 1.1
    player.step(0.0)
    assert [picture.time for picture in pictures] == pytest.approx([1.0, 1.0])
    torque = slice(charts.TORQUE_AT, charts.TORQUE_AT + 3)
    assert np.isnan(pictures[0].rows[-1][torque]).all()
    assert pictures[1].rows[-1][torque] == [1.0] * 3


def test_bag_that_was_cut_short_plays_up_to_there(bag, tmp_path):
    (file,) = bag.rglob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    (recorded,) = read_recorded(cut)
    assert 1.0 < recorded.times[-1] < 7.0
    assert recorded.warnings == (
        f"{cut}: cut short; played up to there; to make it whole, run quadftc repair {cut}",
    )


@pytest.mark.parametrize(
    ("rows", "topics", "words"),
    [
        ([], {"/imu/data": IMU}, r"no message on imu/data \(sensor_msgs/msg/Imu\); topics there: none"),
        (
            [("/camera", 1.0, VectorWire("map")(1, np.ones(3)))],
            {"/camera": VECTOR},
            "no message on imu/data .* there: /camera",
        ),
        (
            [("/imu/data", 1.0, VectorWire("map")(1, np.ones(3)))],
            {"/imu/data": VECTOR},
            "no message on imu/data .* there: /imu/data",
        ),
        (samples(times=(1.0,)), None, "1 samples at one moment on /imu/data"),
    ],
)
def test_bag_without_what_the_page_needs_is_refused(tmp_path, rows, topics, words):
    with pytest.raises(BagError, match=words) as caught:
        read_recorded(write(tmp_path / "bag", rows, topics))
    assert "\n" not in str(caught.value)


def test_folder_without_or_with_several_flights_is_refused(bag, tmp_path):
    with pytest.raises(BagError, match="no run in this directory"):
        read_recorded(tmp_path)
    for name in ("a", "b"):
        write(tmp_path / name, samples())
    with pytest.raises(BagError, match=f"holds 2 flights; give one of them, such as {tmp_path}/a"):
        read_recorded(tmp_path)
    (tmp_path / "a" / "parameters.yaml").write_text("[")
    with pytest.raises(BagError, match=r"a: parameters.yaml makes no sense"):
        read_recorded(tmp_path / "a")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"bag": Path("x"), "attach": True}, "--bag: plays what has flown; only --speed"),
        ({"bag": Path("x"), "rate": "500"}, "--bag: plays what has flown; only --speed"),
        ({"speed": 2.0}, "--speed: belongs to --bag"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        live(**options)


def test_recorded_flight_is_played_in_a_browser(bag):
    """It goes to a fault, pauses there and goes back; there is no way to inject one."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.support.wait import WebDriverWait

    command = [sys.executable, "-c", RUN, "--bag", str(bag), "--no-browser", "--port", "0", "--speed", "0.5"]
    with (
        start_browser("THE PAGE OF A RECORDED FLIGHT", "--enable-unsafe-swiftshader") as browser,
        subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process,
        contextlib.ExitStack() as ends,
    ):
        ends.callback(process.kill)
        lines = iter(process.stderr.readline, "")
        address = next((found[1] for line in lines if (found := re.match(r"page: +(http\S+)", line))), None)
        assert address is not None
        waits = WebDriverWait(browser, PATIENCE)

        def await_one(selector: str):
            return waits.until(lambda each: each.find_elements("css selector", selector), selector)[0]

        def moment() -> float:
            return float(browser.find_element("css selector", '[data-show="moment"]').text.partition(" ")[0])

        browser.get(address)
        await_one('[data-element="attitude/pitch"][data-state="healthy"]')
        await_one("[data-event]").click()
        await_one('[data-element="attitude/pitch"][data-state="faulty"]')
        await_one('[data-play][aria-label="pause"]').click()
        await_one('[data-play][aria-label="play"]')
        paused = moment()
        assert paused >= 5.0
        drawn = (
            "return getElement(document.querySelector('.chart').id.slice(1)).chart.getOption().series[1].data"
        )
        waits.until(lambda _: browser.execute_script(drawn)[-1][0] == 0.0)
        assert moment() == paused
        slider = browser.find_element("css selector", "[data-seek]")
        ActionChains(browser).move_to_element_with_offset(
            slider, -slider.size["width"] // 2, 0
        ).click().perform()
        waits.until(lambda _: moment() == 0.0)
        waits.until(lambda _: len(browser.execute_script(drawn)) == 1, "what came later is gone")
        assert browser.find_elements("css selector", "[data-fault], [data-setpoint]") == []
        assert [each for each in browser.get_log("browser") if each["level"] == "SEVERE"] == []
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
