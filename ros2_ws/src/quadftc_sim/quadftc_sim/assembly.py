"""The simulator and the fault injector from the parameters of their nodes.

The node ``plant`` has those of `PlantParameters`, disturbances (list of specifications), and those of the
plant that it names. ``imu.<parameter>`` are those of the sensor. In free flight it has a list of winds, too,
and ``position.``, ``mag.`` and ``baro.<parameter>`` of position sensor, magnetometer and barometer. The node
``fault_injector`` has those of `InjectorParameters` and faults (list of specifications). Others are ignored.
A ValueError names the parameter that is wrong.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

from quadftc_model import assembly
from quadftc_model.assembly import NodeParameters, get
from quadftc_model.parameters import parameter
from quadftc_model.stepper import Engine, NumpyRunner, seconds
from quadftc_sim.barometer import Barometer
from quadftc_sim.disturbance import disturbances
from quadftc_sim.injection import Injection, make_injection
from quadftc_sim.injector import FaultInjector
from quadftc_sim.magnetometer import Magnetometer
from quadftc_sim.plant import Plant, plants
from quadftc_sim.plants.test_stand import AttitudeStand
from quadftc_sim.position_sensor import PositionSensor
from quadftc_sim.sensors import ImuSensor
from quadftc_sim.simulator import PlantFlight, Simulator
from quadftc_sim.vehicle_simulation import VehicleSimulation
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


def vehicle_from(
    plant: Plant,
    imu: ImuSensor,
    period_ns: int,
    position: PositionSensor | None = None,
    magnetometer: Magnetometer | None = None,
    barometer: Barometer | None = None,
) -> VehicleSimulation:
    """Return a vehicle with its sensors at a period [ns]; a magnetometer or barometer of rate 0 is none."""
    period = seconds(period_ns)
    return VehicleSimulation(
        plant=plant,
        imu=imu,
        period=period,
        position=position.beside(imu.delay, 1.0 / period) if position is not None else None,
        magnetometer=magnetometer if magnetometer is not None and magnetometer.rate > 0.0 else None,
        barometer=barometer if barometer is not None and barometer.rate > 0.0 else None,
    )


def simulator_from(
    parameters: NodeParameters, epoch_ns: int = EPOCH_NS, engine: Engine = NumpyRunner
) -> Simulator:
    """Build the simulator from the parameters of the plant node; its first stamp is ``epoch_ns``."""
    laws = tuple(assembly.components_from(disturbances, parameters, "disturbances"))
    context: dict[str, object] = {"vehicle": assembly.vehicle_from(parameters), "disturbances": laws}
    kind = plants.get(get(parameters, "plant", str)) if "plant" in parameters else AttitudeStand
    if kind.flies:
        context["winds"] = tuple(assembly.components_from(winds, parameters, "winds"))
    plant = assembly.build_named(kind, parameters, **context)
    sensors: list[Any] = []
    if kind.flies:
        there = parameters.get("position_sensor", False)
        sensors = [
            assembly.build_prefixed(PositionSensor, parameters, "position") if there else None,
            assembly.build_prefixed(Magnetometer, parameters, "mag"),
            assembly.build_prefixed(Barometer, parameters, "baro"),
        ]
    imu = assembly.build_prefixed(ImuSensor, parameters, "imu")
    law = vehicle_from(plant, imu, period_ns(get(parameters, "rate", float)), *sensors)
    return Simulator(law, epoch_ns, get(parameters, "seed", int), engine)


def flight_from(
    parameters: NodeParameters,
    epoch_ns: int,
    begin_ns: int,
    before: PlantFlight | None = None,
    engine: Engine = NumpyRunner,
) -> PlantFlight:
    """Build a flight of the plant node: stamp of its first sample, and monotonic time of its begin [ns].

    ``before``: an earlier one with the same parameters, of the same vehicle.
    """
    simulator = before.simulator.anew(epoch_ns) if before else simulator_from(parameters, epoch_ns, engine)
    duration, rate, timeout = (get(parameters, key, float) for key in ("duration", "rate", "torque_timeout"))
    return PlantFlight(simulator, sample_count(duration, rate), timeout, begin_ns)


def injector_from(parameters: NodeParameters, engine: Engine = NumpyRunner) -> FaultInjector:
    """Build the fault injector with its scheduled faults, numbered from 1 in their order."""
    rotors = int(parameters.get("rotors", 0))
    injections = [injection_from(text, rotors) for text in assembly.texts(parameters, "faults")]
    return FaultInjector(get(parameters, "seed", int), injections, rotors, engine)


def injection_from(text: str, rotors: int = 0) -> Injection:
    """Make an injection from its specification, for a vehicle with so many rotors in free flight."""
    return assembly.component_of("fault", text, functools.partial(make_injection, rotors=rotors))
