"""Every law that a node or the closed loop runs, by name: one for each registered component."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from quadftc_control.attitude_loop import AttitudeLoop
from quadftc_control.controller import controllers
from quadftc_control.guidance import FlightGuidance, LiveGuidance, StandGuidance
from quadftc_control.position_controller import position_controllers
from quadftc_control.position_loop import PositionLoop
from quadftc_control.reference import references
from quadftc_control.trajectory import PositionSetpointFilter, trajectories
from quadftc_fdi.disturbance_observer import DisturbanceObservation, disturbance_observers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.observation import Observation
from quadftc_model.guarded import Guarded
from quadftc_model.parameters import build, parameters_of
from quadftc_model.position_estimator import PositionEstimator
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.assembly import vehicle_from
from quadftc_sim.barometer import Barometer
from quadftc_sim.disturbance import disturbances
from quadftc_sim.fault import faults
from quadftc_sim.injection import make_injection
from quadftc_sim.injector import ChannelFault, Join, RotorsFault, Split
from quadftc_sim.magnetometer import Magnetometer
from quadftc_sim.plant import plants
from quadftc_sim.position_sensor import PositionSensor
from quadftc_sim.rotor_fault import rotor_faults
from quadftc_sim.sensors import GRADES, ImuSensor
from quadftc_sim.wind import winds

STAND, FREE = load_vehicle("qball_x4"), load_vehicle("hummingbird")
PERIOD_NS = 4_000_000


def _sized(registry: Any, kind: str, **values: Any) -> Any:
    """A component whose vectors have an amount that is not zero."""
    vectors = [spec.name for spec in parameters_of(registry.get(kind)) if spec.is_vector]
    return build(registry.get(kind), {**dict.fromkeys(vectors, 0.3), **values})


def _laws() -> Iterator[tuple[str, Callable[[], Any]]]:
    for name in fault_observers.names():
        kind = fault_observers.get(name)
        yield name, lambda kind=kind: Guarded(Observation(kind(vehicle=STAND)))
        yield f"{name} in free flight", lambda kind=kind: Guarded(Observation(kind(vehicle=FREE), flies=True))
    for name in disturbance_observers.names():
        kind = disturbance_observers.get(name)
        yield f"disturbance {name}", lambda kind=kind: Guarded(DisturbanceObservation(kind(vehicle=STAND)))
    for name in controllers.names():
        kind = controllers.get(name)
        yield name, lambda kind=kind: Guarded(AttitudeLoop(controller=kind(vehicle=STAND)))
        yield (
            f"{name} in free flight",
            lambda kind=kind: Guarded(AttitudeLoop(controller=kind(vehicle=FREE), flies=True)),
        )
    for name in position_controllers.names():
        yield name, lambda name=name: _guidance(name)
    yield (
        "live setpoints",
        lambda: LiveGuidance(smooth=PositionSetpointFilter(), loop=_guidance("geometric").loop),
    )
    yield (
        "references",
        lambda: StandGuidance(references=tuple(_sized(references, n) for n in references.names())),
    )
    for name in plants.names():
        if plants.get(name).traceable:
            yield f"plant {name}", lambda name=name: _plant(name)
    yield "split", Split
    yield "join", Join
    for name in faults.names():
        for channel in faults.get(name).channels:
            yield f"{name} on {channel}", lambda name=name, channel=channel: _fault(name, channel)
    for name in rotor_faults.names():
        yield (
            f"{name} on rotors",
            lambda name=name: RotorsFault(
                make_injection(name, {"channel": "rotor", "rotors": [2]}, rotors=4)
            ),
        )


def _guidance(name: str) -> FlightGuidance:
    found = tuple(_sized(trajectories, each) for each in trajectories.names() if each != "waypoints")
    way = build(trajectories.get("waypoints"), {"points": ((0.0, 0.0, 1.0), (2.0, 1.0, 2.0))})
    controller = position_controllers.get(name)(vehicle=FREE)
    return FlightGuidance(
        trajectories=(*found, way), loop=PositionLoop(estimator=PositionEstimator(), controller=controller)
    )


def _plant(name: str) -> Any:
    kind = plants.get(name)
    more = {"disturbances": tuple(_sized(disturbances, each) for each in disturbances.names())}
    if not kind.flies:
        return vehicle_from(kind(vehicle=STAND, **more), ImuSensor(**GRADES["ahrs"]), PERIOD_NS)
    more["winds"] = tuple(_sized(winds, each) for each in winds.names())
    sensors = PositionSensor(), Magnetometer(), Barometer()
    return vehicle_from(kind(vehicle=FREE, **more), ImuSensor(**GRADES["mems"]), PERIOD_NS, *sensors)


def _fault(name: str, channel: str) -> ChannelFault:
    kind = faults.get(name)
    vectors = dict.fromkeys((spec.name for spec in parameters_of(kind) if spec.is_vector), 0.3)
    return ChannelFault(make_injection(name, {"channel": channel, **vectors}).for_period(PERIOD_NS / 1e9))


EVERY_LAW: dict[str, Callable[[], Any]] = dict(_laws())
