"""Laws by name as they fly on a vehicle, guarded, and the samples of recordings as their inputs."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from quadftc_compile.export import Exported, export_of, write_example, write_law, write_readme
from quadftc_compile.layout import layout_of
from quadftc_compile.recipe import recipe_of
from quadftc_compile.samples import write_samples
from quadftc_control.attitude_loop import AttitudeLoop
from quadftc_control.controller import controllers
from quadftc_fdi.disturbance_observer import (
    DisturbanceObservation,
    DisturbanceObservationInputs,
    disturbance_observers,
)
from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.observation import Observation, ObservationInputs
from quadftc_flight.scenario import parse_value
from quadftc_model.arrays import rows_of
from quadftc_model.guarded import Guarded
from quadftc_model.hints import nearest
from quadftc_model.parameters import build
from quadftc_model.registry import Registry
from quadftc_model.stepper import MAX_GAP, NANOSECONDS_PER_SECOND
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.imu_recording import Recording

GUARD = (
    "`out.said` is always finite. `out.failed`: the law gave what cannot be used, something else is said in "
    "its place, and the law begins at the next sample.",
)
SENSED = (
    "`in.sample` is what `imu/data` carries: attitude as quaternion x, y, z, w, body to earth (east, north, "
    "up); body axes are forward, left, up.",
)
ACTED = (
    "`in.torque` is what acted since the sample before. Where it is not known: zero, and `in.driven` false.",
)
FLOWN = (
    "`in.rotors.command` are the speeds commanded since the sample before; `in.position` is a position that "
    "came with this sample, if `there`.",
)


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of law that can be exported."""

    registry: Registry[Any]
    flown: Callable[[Any, bool], Any]  # a law, in free flight or on the test stand, on received samples
    notes: Callable[[bool], Sequence[str]]  # what its user has to know
    inputs: Callable[[Recording], object] | None  # those of a recording; None: it has not all of them


def _observed(recording: Recording) -> ObservationInputs:
    return ObservationInputs(recording.imu, recording.torque, driven=np.bool_(recording.driven))


def _disturbed(recording: Recording) -> DisturbanceObservationInputs:
    return DisturbanceObservationInputs(recording.imu, recording.torque)


KINDS = (
    Kind(fault_observers, Observation, lambda flies: (*SENSED, *(FLOWN if flies else ACTED)), _observed),
    Kind(
        disturbance_observers,
        lambda law, flies: DisturbanceObservation(law),
        lambda flies: ("`in.torque` is what acted since the sample before.",),
        _disturbed,
    ),
    Kind(
        controllers,
        lambda law, flies: AttitudeLoop(controller=law, flies=flies),
        lambda flies: (
            "`in.last` is the torque that is commanded at present: it is held where the law fails.",
        ),
        None,
    ),
)


def kind_of(name: str) -> Kind:
    """Return what kind of law has a name; of two kinds the first; ValueError if there is none."""
    for kind in KINDS:
        if name in kind.registry.names():
            return kind
    known = [each for kind in KINDS for each in kind.registry.names()]
    there = "; ".join(f"{kind.registry.kind}s: {', '.join(kind.registry.names())}" for kind in KINDS)
    raise ValueError(f"no law '{name}'{nearest(name, known)}; {there}")


def guarded_law(name: str, vehicle: str, settings: Sequence[str] = (), flies: bool = False) -> Any:
    """Return a law by name, guarded, for a vehicle (name or TOML file); settings are ``parameter=value``."""
    kind, values = kind_of(name), dict[str, object]()
    for setting in settings:
        parameter, equals, value = setting.partition("=")
        if not equals or not parameter.strip():
            raise ValueError(f"--set {setting!r}: expected parameter=value")
        values[parameter.strip()] = parse_value(value, f"--set {setting!r}")
    law = build(kind.registry.get(name), values, vehicle=load_vehicle(vehicle))
    return Guarded(kind.flown(law, flies))


def exported_law(name: str, law: Any, real: str = "double") -> Exported:
    """Return a guarded law as C, "double" or "float"; ValueError if it cannot be traced."""
    return export_of(recipe_of(law, law.example(), name=re.sub(r"\W", "_", name)), real)


def write_export(exported: Exported, name: str, folder: Path, flies: bool = False) -> None:
    """Write a law into a folder."""
    kind, law = kind_of(name), exported.recipe.law.named_after.named_after
    write_law(exported, folder)
    write_example(exported, folder)
    summary = (inspect.getdoc(kind.registry.get(name)) or "").partition("\n")[0]
    place = "free flight" if flies else "the test stand"
    about = f"{summary} A {kind.registry.kind} of quadftc for {law.vehicle.name}, {place}."
    recorded = (
        "" if flies or kind.inputs is None else f"quadftc export {name} --samples BAG --out samples.csv"
    )
    write_readme(exported, folder, about, [*GUARD, *kind.notes(flies)], recorded)


def recorded_inputs(name: str = "") -> Callable[[Recording], object]:
    """Return what takes the inputs of a law out of a recording: by default, of fault observers."""
    kind = kind_of(name) if name else KINDS[0]
    if kind.inputs is None:
        raise ValueError(f"--samples: a recording has no inputs of a {kind.registry.kind} ('{name}')")
    return kind.inputs


def write_recording(recording: Recording, path: Path, inputs: object) -> None:
    """Write the samples of a recording with the inputs that a law takes of it, arrays (n, ...)."""
    gaps = np.diff(recording.stamp_ns) / NANOSECONDS_PER_SECOND
    dt = np.concatenate([[0.0], np.where(gaps > MAX_GAP, 0.0, gaps)])  # 0: the law begins
    write_samples(path, layout_of(rows_of(inputs, 0)), dt, inputs)
