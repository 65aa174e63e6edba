"""The simulator and the fault injector from the parameters of their nodes.

The node ``plant`` has those of `PlantParameters`, disturbances (list of specifications), those of the plant
that ``plant`` names and ``imu.<parameter>`` for each parameter of the sensor. In free flight it has a list of
winds, too, and ``position.<parameter>``, ``mag.<parameter>`` and ``baro.<parameter>`` for each parameter of
position sensor, magnetometer and barometer. The node
``fault_injector`` has those of `InjectorParameters` and faults (list of specifications). Others are ignored.
A ValueError names the parameter that is wrong.
"""

from __future__ import annotations

import dataclasses
import functools

from quadftc_model import assembly
from quadftc_model.assembly import NodeParameters, get
from quadftc_model.parameters import parameter
from quadftc_sim.barometer import Barometer
from quadftc_sim.disturbance import disturbances
from quadftc_sim.injection import Injection, make_injection
from quadftc_sim.injector import FaultInjector
from quadftc_sim.magnetometer import Magnetometer
from quadftc_sim.motion import compiled_motion
from quadftc_sim.plant import plants
from quadftc_sim.plants.test_stand import AttitudeStand
from quadftc_sim.position_sensor import PositionSensor
from quadftc_sim.sensors import ImuSensor
from quadftc_sim.simulator import PlantFlight, Simulator
from quadftc_sim.wind import winds

EPOCH_NS = 1_000_000_000  # ns; stamp of the first sample in lock-step, where 0 means "unset"


@dataclasses.dataclass(frozen=True)
class PlantParameters:
    """Parameters of the node besides those of the plant and, behind ``imu.``, :class:`ImuSensor`."""

    plant: str = parameter("test_stand", doc="name of the plant")
    position_sensor: bool = parameter(False, doc="in free flight: a position sensor is there")
    vehicle: str = parameter("qball_x4", doc="name of a vehicle, or path of its TOML file")
    rate: float = parameter(250.0, unit="Hz", low=10.0, high=4000.0, doc="control rate")
    duration: float = parameter(0.0, unit="s", low=0.0, doc="length of the flight; 0: without end")
    seed: int = parameter(0, low=0, doc="of the sensor's noise and bias")
    start_when_connected: bool = parameter(
        True, doc="start as soon as the graph is connected; else wait for ~/start"
    )
    torque_timeout: float = parameter(
        0.5,
        unit="s",
        low=0.0,
        doc="real time: zero torque when none has come for so long, as a motor controller does",
    )


@dataclasses.dataclass(frozen=True)
class InjectorParameters:
    """Parameters of the fault injector node."""

    seed: int = parameter(0, low=0, doc="of the random faults (noise, spikes, dropout)")
    rotors: int = parameter(
        0, low=0, high=64, doc="rotors of a vehicle in free flight; 0: it has none to fail"
    )


def period_ns(rate: float) -> int:
    """Control period [ns] of a rate [Hz], to the nearest nanosecond."""
    if not 0.0 < rate <= 1e9:
        raise ValueError(f"rate = {rate!r} Hz: must be positive")
    return round(1e9 / rate)


def sample_count(duration: float, rate: float) -> int:
    """Number of samples that the plant takes in ``duration`` [s] at ``rate`` [Hz]."""
    return round(duration * rate)


def simulator_from(parameters: NodeParameters, epoch_ns: int = EPOCH_NS) -> Simulator:
    """Build the simulator from the parameters of the plant node; its first stamp is ``epoch_ns``."""
    laws = tuple(assembly.components_from(disturbances, parameters, "disturbances"))
    context = {"vehicle": assembly.vehicle_from(parameters), "disturbances": laws}
    kind = plants.get(get(parameters, "plant", str)) if "plant" in parameters else AttitudeStand
    if kind.flies:
        context["winds"] = tuple(assembly.components_from(winds, parameters, "winds"))
    plant = assembly.build_named(kind, parameters, **context)
    sensor = assembly.build_prefixed(ImuSensor, parameters, "imu")
    there = kind.flies and parameters.get("position_sensor", False)
    place = assembly.build_prefixed(PositionSensor, parameters, "position") if there else None
    magnetometer = assembly.build_prefixed(Magnetometer, parameters, "mag")
    barometer = assembly.build_prefixed(Barometer, parameters, "baro")
    period = period_ns(get(parameters, "rate", float))
    motion = compiled_motion(plant) if parameters.get("compiled", False) else None
    seed = get(parameters, "seed", int)
    return Simulator(plant, sensor, period, epoch_ns, seed, place, motion, magnetometer, barometer)


def flight_from(
    parameters: NodeParameters, epoch_ns: int, begin_ns: int, before: PlantFlight | None = None
) -> PlantFlight:
    """Build a flight of the plant node: stamp of its first sample, and monotonic time of its begin [ns].

    ``before``: an earlier one with the same parameters, of the same vehicle.
    """
    simulator = before.simulator.anew(epoch_ns) if before else simulator_from(parameters, epoch_ns)
    duration, rate, timeout = (get(parameters, key, float) for key in ("duration", "rate", "torque_timeout"))
    return PlantFlight(simulator, sample_count(duration, rate), timeout, begin_ns)


def injector_from(parameters: NodeParameters) -> FaultInjector:
    """Build the fault injector with its scheduled faults, numbered from 1 in their order."""
    rotors = int(parameters.get("rotors", 0))
    injections = [injection_from(text, rotors) for text in assembly.texts(parameters, "faults")]
    return FaultInjector(get(parameters, "seed", int), injections)


def injection_from(text: str, rotors: int = 0) -> Injection:
    """Make an injection from its specification, for a vehicle with so many rotors in free flight."""
    return assembly.component_of("fault", text, functools.partial(make_injection, rotors=rotors))
