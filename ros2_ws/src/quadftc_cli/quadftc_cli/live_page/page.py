# pyright: basic
"""The page: the vehicle in 3D, strip charts, states of all components, faults to inject, setpoints."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from fastapi import FastAPI
from nicegui import background_tasks, ui
from nicegui.events import GenericEventArguments, ValueChangeEventArguments

from quadftc_cli.live_page.charts import StripCharts
from quadftc_cli.live_page.commander import Commander, Injected
from quadftc_cli.live_page.feed import Flown
from quadftc_cli.live_page.picture import Picture, State
from quadftc_cli.live_page.player import Player
from quadftc_cli.live_page.scene import CORRECTED, MEASURED, TRUTH, VehicleScene
from quadftc_flight.fault_schedule import UNKNOWN_KIND, FaultEvent
from quadftc_flight.graph.plan import GraphError
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import AXES
from quadftc_ros.latest import ROLES
from quadftc_ros.wire import pose_of

FRAME_PERIOD = 1.0 / 30.0  # s
TEXT_PERIOD = 0.2  # s; between two looks at states and numbers
SLOW = 0.95  # of real time; a flight below it says so
STYLE = Path(__file__).with_name("page.css")
BACKEND = "_backend"  # end of the name of the node behind an autopilot's simulation
RATES = ("controller", "fault_observer")  # nodes that may report a rate
SENSOR_FAULTS = (  # label, axis that the charts show then, fault
    ("roll reads +8°", 0, "bias axis=roll value=8deg"),
    ("pitch wanders ±5°", 1, "sine axis=pitch amplitude=5deg frequency=0.5Hz"),
    ("yaw is stuck", 2, "stuck axis=yaw duration=10s"),
    ("gyro x +10°/s", 0, "bias channel=gyro axis=x value=10deg/s"),
    ("gyro y stuck", 1, "stuck channel=gyro axis=y"),
    ("accelerometer x +1 m/s²", 0, "bias channel=accelerometer axis=x value=1"),
)
ROTOR_FAULTS = (
    ("rotor 1 loses 30 %", 0, "loss rotors=1 value=30%"),
    ("rotor 3 loses 15 %", 0, "loss rotors=3 value=15%"),
)
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
BEFORE, MOST = 1.0, 50  # s, before a fault to which one goes; faults of a recording that are listed
SLIDERS = {  # target -> name, unit shown, SI per unit, least, largest, step
    "attitude": (
        ("roll", "°", math.radians(1.0), -20.0, 20.0, 0.5),
        ("pitch", "°", math.radians(1.0), -20.0, 20.0, 0.5),
        ("yaw", "°", math.radians(1.0), -90.0, 90.0, 1.0),
    ),
    "position": (
        ("x", "m", 1.0, -3.0, 3.0, 0.1),
        ("y", "m", 1.0, -3.0, 3.0, 0.1),
        ("z", "m", 1.0, 0.5, 3.0, 0.1),
        ("yaw", "°", math.radians(1.0), -90.0, 90.0, 1.0),
    ),
}


class Vehicle(NamedTuple):
    """A vehicle that can be shown."""

    picture: Picture
    commander: Commander
    flown: Flown
    player: Player | None = None  # of a recorded flight
    events: tuple[FaultEvent, ...] = ()  # its faults


def add_page(app: FastAPI, vehicles: Sequence[Vehicle]) -> None:
    """Add the page to an application: of several vehicles it shows the one whose number the address has."""
    names = {number: each.flown.namespace or "no namespace" for number, each in enumerate(vehicles)}

    @ui.page("/")
    def page(vehicle: int = 0) -> None:
        ui.add_css(STYLE)
        number = vehicle if vehicle in names else 0
        _Page(vehicles[number], number, names)

    ui.run_with(app, title="quadftc live", dark=None, tailwind=False, show_welcome_message=False)


def words_of(event: FaultEvent) -> str:
    """Say when which element of a component was faulty, and how, as far as that is known."""
    names = AXES if event.component == "attitude" else "xyz"
    element = names[AXES.index(event.axis)] if event.axis in AXES else event.axis
    kind = "" if event.kind == UNKNOWN_KIND else f": {event.kind}"
    return f"{event.start:.2f} to {event.stop:.2f} s  {event.component} {element}{kind}"


class _Page:
    """One page, for as long as a browser shows it."""

    def __init__(self, vehicle: Vehicle, number: int, names: Mapping[int, str]) -> None:
        self._picture, self._commander, self._flown, self._player, events = vehicle
        picture, _, flown, player, _ = vehicle
        self._chips: dict[str, ui.label] = {}
        self._shown: dict[str, ui.label] = {}
        with ui.element("div").classes("page"):
            self._heading(number, names)
            with ui.element("div").classes("stage"):
                self._scene = VehicleScene(picture)
                self._legend()
                if player is not None:
                    self._seeking = False
                    self._controls(player)
            with ui.element("div").classes("side"):
                self._components()
                if flown.simulated:
                    self._faults()
                if flown.home is not None:
                    self._setpoints()
                if player is not None:
                    self._recorded_faults(player, events)
            with ui.element("div").classes("lower"):
                self._axis_choice()
                self._charts = StripCharts(picture)
        ui.timer(FRAME_PERIOD, self._draw)
        ui.timer(TEXT_PERIOD, self._tell)

    def _heading(self, number: int, names: Mapping[int, str]) -> None:
        def choose(event: ValueChangeEventArguments) -> None:
            ui.navigate.to(f"/?vehicle={event.value}")

        with ui.element("header").classes("heading"):
            ui.label("quadftc live").classes("brand")
            if len(names) > 1:
                choice = ui.select(dict(names), value=number, on_change=choose)
                choice.props('dense borderless options-dense aria-label="vehicle" data-vehicle')
            else:
                ui.label(self._flown.title).classes("title")
            self._shown["parts"] = ui.label(self._flown.parts).classes("parts")
            ui.element("div").classes("space")
            of_plant = ("lost", "speed") if self._flown.simulated else ()
            of_flight = () if self._player else ("time", "rate", *of_plant)
            for name in (*of_flight, "mode"):
                self._shown[name] = ui.label().classes("number").props(f'data-show="{name}"')

    def _legend(self) -> None:
        with ui.element("div").classes("legend"):
            for name, colour in (("truth", TRUTH), ("measured", MEASURED), ("corrected", CORRECTED)):
                with ui.element("span"):
                    ui.element("i").style(f"background: {colour}")
                    ui.label(name)
                    self._shown[name] = ui.label().classes("number")

    def _components(self) -> None:
        with ui.element("section"):
            ui.label("Components").classes("heading-2")
            with ui.element("div").classes("components"):
                for component, elements in self._picture.states().items():
                    ui.label(component)
                    with ui.element("div").classes("chips"):
                        for element in elements:
                            name = f"{component}/{element}"
                            self._chips[name] = (
                                ui.label(element).classes("chip").props(f'data-element="{name}"')
                            )
            self._shown["findings"] = ui.label().classes("findings").props('data-show="findings"')
            self._shown["warnings"] = ui.label().classes("warnings")

    def _faults(self) -> None:
        presets = SENSOR_FAULTS + (ROTOR_FAULTS if self._picture.rotors else ())
        with ui.element("section"):
            ui.label("Inject a fault").classes("heading-2")
            with ui.element("div").classes("buttons"):
                for label, axis, fault in presets:
                    button = ui.button(label, color=None, on_click=partial(self._inject, fault, axis))
                    button.props(f'unelevated no-caps dense data-fault="{fault}"')
            with ui.element("div").classes("own"):
                own = ui.input(value="noise axis=roll sigma=1deg", placeholder="as quadftc inject takes it")
                own.props('dense outlined aria-label="fault to inject"').on(
                    "keydown.enter", lambda: self._inject(own.value or "")
                )
                button = ui.button("Inject", on_click=lambda: self._inject(own.value or ""))
                button.props("unelevated no-caps color=grey-8")
            with ui.element("div").classes("injected"):
                self._injected = ui.element("div").classes("chips")
                clear = ui.button(
                    "Clear all", color=None, on_click=lambda: self._attempt(self._commander.clear())
                )
                clear.props('outline no-caps dense data-clear="all"')
            self._listed: list[Injected] | None = None

    def _setpoints(self) -> None:
        target = "position" if self._picture.latest.flies else "attitude"
        names = [row[0] for row in SLIDERS[target]]
        values = self._commander.setpoints.setdefault(
            target, dict(zip(names, self._flown.home or (), strict=True))
        )

        def take(name: str, unit: str, scale: float, shown: ui.label, event: GenericEventArguments) -> None:
            values[name] = float(event.args) * scale
            shown.set_text(f"{event.args:g} {unit}")
            self._attempt(self._commander.set(target, values))

        with ui.element("section"):
            ui.label(f"{target.capitalize()} setpoint").classes("heading-2")
            with ui.element("div").classes("sliders"):
                for name, unit, scale, low, high, step in SLIDERS[target]:
                    ui.label(name)
                    slider = ui.slider(min=low, max=high, step=step, value=values[name] / scale)
                    shown = ui.label(f"{slider.value:g} {unit}").classes("number")
                    slider.props(f'dense color=grey-7 data-setpoint="{name}"')
                    slider.props(f'aria-label="{target} setpoint: {name} [{unit}]"')
                    slider.on("update:model-value", partial(take, name, unit, scale, shown), throttle=0.1)

    def _controls(self, player: Player) -> None:
        """Lay play, pause, the slider and the speed over the picture."""

        def pan(event: GenericEventArguments) -> None:
            self._seeking = event.args == "start"

        def seek(event: GenericEventArguments) -> None:
            player.wanted = float(event.args)

        def hasten(event: ValueChangeEventArguments) -> None:
            player.speed = float(event.value)

        with ui.element("div").classes("player"):
            self._play = ui.button(color=None, on_click=player.toggle).props("flat round data-play")
            self._moment = ui.slider(min=0.0, max=player.duration, step=0.1, value=player.time)
            self._moment.props('color=grey-7 aria-label="time of the flight [s]" data-seek')
            self._moment.on("pan", pan)
            self._moment.on("update:model-value", seek, throttle=0.1)
            self._shown["moment"] = ui.label().classes("number").props('data-show="moment"')
            speeds = {speed: f"{speed:g} x" for speed in sorted({*SPEEDS, player.speed})}
            choice = ui.select(speeds, value=player.speed, on_change=hasten)
            choice.props('dense borderless options-dense aria-label="speed" data-speed')

    def _recorded_faults(self, player: Player, events: Sequence[FaultEvent]) -> None:
        """List the faults of a recording, each with a way there."""

        def go(event: FaultEvent) -> None:
            if event.axis in AXES:
                self._axis.set_value(event.axis)
            player.wanted, player.playing = event.start - BEFORE, True

        with ui.element("section"):
            ui.label("Faults in the recording").classes("heading-2")
            with ui.element("div").classes("buttons recorded"):
                for event in events[:MOST]:
                    button = ui.button(words_of(event), color=None, on_click=partial(go, event))
                    button.props("unelevated no-caps dense align=left data-event")
            more = f"{len(events) - MOST} more. " if len(events) > MOST else ""
            ui.label(f"{more or ('' if events else 'None known. ')}A recording takes no new faults.")

    def _axis_choice(self) -> None:
        def choose(event: ValueChangeEventArguments) -> None:
            self._charts.choose(AXES.index(event.value))

        with ui.element("div").classes("axis"):
            ui.label("Charts of")
            names = {axis: f"{axis}, {letter}" for axis, letter in zip(AXES, "xyz", strict=True)}
            self._axis = ui.toggle(names, value=AXES[0], on_change=choose).props(
                "dense no-caps unelevated toggle-color=grey-8"
            )

    def _inject(self, fault: str, axis: int | None = None) -> None:
        if axis is not None:
            self._axis.set_value(AXES[axis])
        self._attempt(self._commander.inject(fault))

    def _attempt(self, act: Awaitable[object]) -> None:
        """Do what may be refused, and say why."""

        async def attempt() -> None:
            try:
                await act
            except (ValueError, GraphError) as error:
                with self._scene.element:
                    ui.notify(str(error), type="negative", position="bottom-right")

        background_tasks.create(attempt())

    def _draw(self) -> None:
        """Show a frame."""
        pose = self._picture.latest.read("position/reference", pose_of)
        self._scene.show(None if pose is None else pose[0])
        self._charts.push()

    def _tell(self) -> None:
        """Show states and numbers."""
        picture = self._picture
        findings: list[str] = []
        states = picture.states()
        for component, elements in states.items():
            for element, state in elements.items():
                self._mark(f"{component}/{element}", state)
                if state.name in ("faulty", "ambiguous", "recovering") and " since " in state.words:
                    findings.append(f"{component} {element}: {state.words}")
        watched = any(state.name != "unwatched" for each in states.values() for state in each.values())
        nothing = "no fault found" if watched else "the observer watches no component"
        self._set("findings", "\n".join(findings) or nothing)
        said: dict[str, list[str]] = {}  # by words, who says so
        for _, name, words in picture.warnings():
            if "fault" not in name:
                said.setdefault(words, []).append(name.partition(":")[0].removesuffix(BACKEND))
        self._set("warnings", "\n".join(f"{', '.join(names)}: {words}" for words, names in said.items()))
        silent = "control/status" in picture.silent  # an autopilot flew, whose mode was not recorded
        self._set("mode", "" if silent else f"controller: {picture.mode()}")
        if self._player is not None:
            self._tell_moment(self._player)
        else:
            self._set("time", "flight ended" if picture.over else f"{picture.time:.1f} s")
            rates = (picture.value(node, "timing", "rate_hz") for node in RATES)
            self._set("rate", f"{next(filter(None, rates), '-')} Hz")
        self._set("parts", picture.parts(self._flown.parts))
        self._show_angles()
        if self._flown.simulated:
            lost = picture.value("plant", "flight", "without_torque") or "0"
            self._set("lost", "" if lost == "0" else f"{lost} without torque")
            slow = not picture.over and picture.speed < SLOW
            words = (
                f"slowed to {picture.speed:.2f} x real time: this machine is too slow"
                if slow
                else "real time"
            )
            self._set("speed", words)
            self._shown["speed"].classes(add="slow" if slow else "", remove="" if slow else "slow")
            self._list_injected()

    def _tell_moment(self, player: Player) -> None:
        """Show where a recording is."""
        self._play.props(f"icon={'pause' if player.playing else 'play_arrow'}")
        self._play.props(f"aria-label={'pause' if player.playing else 'play'}")
        self._set("moment", f"{player.time:.1f} / {player.duration:.1f} s")
        if not self._seeking:
            self._moment.set_value(round(player.time, 2))

    def _show_angles(self) -> None:
        """Say what the angle of the axis that the charts show is."""
        axis, attitudes = str(self._axis.value), self._picture.latest.attitudes()
        for role in ROLES:
            words = "-"
            if role in attitudes:
                angle = math.degrees(euler_from_quaternion(attitudes[role])[AXES.index(axis)])
                words = f"{axis} {angle:+.2f}°"
            self._set(role, words)

    def _mark(self, name: str, state: State) -> None:
        chip = self._chips[name]
        if chip.props.get("data-state") != state.name:
            chip.props(f'data-state="{state.name}" title="{state.name}"')

    def _set(self, name: str, text: str) -> None:
        if self._shown[name].text != text:
            self._shown[name].set_text(text)

    def _list_injected(self) -> None:
        """List the faults of the page, each with a button that ends it."""
        listed = list(self._commander.injected)
        if listed == self._listed:
            return
        self._listed = listed
        self._injected.clear()
        with self._injected:
            for each in listed:
                chip = ui.chip(each.words, removable=True, color="orange-2").props(
                    "dense square text-color=grey-10"
                )
                chip.on_value_change(
                    lambda _, number=each.number: self._attempt(self._commander.clear(number))
                )
