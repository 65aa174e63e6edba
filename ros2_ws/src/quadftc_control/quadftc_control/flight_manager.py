"""What the controller decides in flight: which IMU it flies on, what it commands, what it keeps for others.

For each sample, `InputMonitor` says which IMU is used and whether the disturbance estimate is trusted (the
mode). `Transfer` makes the change from one IMU to another continuous. `AttitudeLoop` gives torque and rotor
speeds. `LastWords` keeps what both observers said last, for observers that restart.

Pure: samples and stamps come in, a `Command` comes out, and `kept` collects what is published beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadftc_control.attitude_loop import AttitudeLoop, AttitudeLoopInputs, AttitudeLoopOutput, nothing_but
from quadftc_control.controller import Controller, limited
from quadftc_control.input_monitor import HeldTorque, InputMonitor, Mode, Patience
from quadftc_control.last_words import LastWords, MessageReader
from quadftc_control.transfer import Transfer
from quadftc_model import samples
from quadftc_model.arrays import Components, Vector
from quadftc_model.fade import Fade
from quadftc_model.guarded import GuardedStepper
from quadftc_model.samples import AttitudeCommand, ControllerOutput, ImuSample
from quadftc_model.stepper import Engine, NumpyRunner, seconds

ROTORS_AGE = 0.1  # s; measured speeds that differ by more from the sample are not of its time


class Command(NamedTuple):
    """What the controller commands for a sample."""

    stamp_ns: int
    output: ControllerOutput
    mode: Mode
    speeds: Components | None  # of the rotors [rad/s], in free flight


class FlightManager:
    """Flies one vehicle on whatever comes, in free flight if it ``flies``.

    ``law`` is for when there is a disturbance estimate; ``count`` gets the reason when an input or output
    cannot be used.
    """

    def __init__(
        self,
        law: Controller,
        patience: Patience,
        reader: MessageReader,
        count: Callable[[str], None],
        flies: bool = False,
        engine: Engine = NumpyRunner,
    ) -> None:
        self._flies, self._count, self._reader = flies, count, reader
        self._law = self._loop_of(law)
        self._torque: Vector = np.zeros(3)  # last command [N m]
        self._stepper = GuardedStepper[AttitudeLoopInputs, AttitudeLoopOutput](self._law, engine=engine)
        self._monitor, self._transfer = InputMonitor(patience), Transfer(patience)
        self._last_words = LastWords(reader)
        self._held = HeldTorque()
        self._next: AttitudeLoop | None = None  # takes over with the next sample
        self._fade = Fade()  # of the torque (3,) [N m]
        self._status: object = None  # last status of a silent observer, if it helps one that restarts
        self._mode: Mode | None = None
        self.stamp_ns = 0  # of the last command [ns]; 0 before the first
        self._watched_ns = self._silent_since_ns = 0
        self._missing = 0.0  # share of the disturbance estimate that is missing
        self._trusted = False  # the disturbance estimate
        self.wanted: AttitudeCommand | None = None
        self.wanted_ns = 0
        self._speeds: tuple[int, Components] | None = None  # of the rotors: stamp [ns], measured [rad/s]
        self.effectiveness = self._healthy  # of the rotors, as last estimated [1]
        # To publish for observers that restart, oldest first; whoever publishes it clears it: (what, stamp
        # [ns], value), "fault" with a status message, "gyro" or "disturbance" with an array (3,).
        self.kept: list[tuple[str, int, Any]] = []

    def configure(self, law: Controller, patience: Patience) -> None:
        """Change parameters in flight, or the law: another one takes over without a jump of the torque."""
        changed = self._loop_of(law)
        if self.has(law):
            self._law, self._next = changed, None
            self._stepper.law = changed.without_estimate(self._missing)
        else:
            self._next = changed
        self._monitor.patience = self._transfer.patience = patience

    def has(self, law: Controller) -> bool:
        """Return whether it flies a law of this kind now."""
        return type(law) is type(self._law.controller)

    @property
    def restarts(self) -> int:
        """How often the law gave what cannot be used, and started again."""
        return self._stepper.replaced

    def must_keep(self) -> str:
        """Return why another law must not take over now; empty: it may."""
        if self._mode not in (None, Mode.FULL):
            return "something is missing: the controller does not fly in mode full"
        return "a rotor is weak" if np.any(self.effectiveness < 1.0) else ""

    def restart(self) -> None:
        """Take the next sample for the first of a flight."""
        self._stepper.reset()
        self._transfer.reset()
        self.effectiveness = self._healthy

    def take_reference(self, stamp_ns: int, wanted: AttitudeCommand) -> AttitudeCommand | None:
        """Note a reference and the thrust that comes with it; return the last usable one."""
        if samples.is_usable(*wanted.attitude) and abs(wanted.thrust) < samples.UNUSABLE:
            self.wanted, self.wanted_ns = wanted, stamp_ns
        else:
            self._count("attitude/reference: not finite")
        return self.wanted

    def take_disturbance(self, stamp_ns: int, disturbance: Vector) -> Vector:
        """Note a disturbance estimate (3,) [rad/s²]; return it, or zero if it cannot be used."""
        if not samples.is_usable(disturbance):
            self._count("disturbance/estimate: not finite")
            return np.zeros(3)
        self._monitor.estimate = stamp_ns, disturbance
        return disturbance

    def take_speeds(self, stamp_ns: int, speeds: Components) -> Components | None:
        """Note measured rotor speeds [rad/s]; return them, None if they cannot be used."""
        if not samples.is_usable(speeds, speeds * speeds):  # as thrust grows with the square
            self._count("rotors/speed: not finite")
            return None
        self._speeds = stamp_ns, speeds
        return speeds

    def take_effectiveness(self, effectiveness: Components | None) -> Components:
        """Note the estimated effectiveness of the rotors; return what to fly with: 1 without a usable one."""
        if effectiveness is not None and not samples.is_usable(effectiveness):
            self._count("rotors/status: not finite")
            effectiveness = None
        self.effectiveness = self._healthy if effectiveness is None else effectiveness
        return self.effectiveness

    def take_status(self, stamp_ns: int, data: bytes) -> None:
        """Note fault/status, serialised."""
        self._last_words.status = data

    def take_bias(self, stamp_ns: int, bias: Vector) -> None:
        """Note what the gyro is off by (3,) [rad/s]."""
        if samples.is_usable(bias):
            self._last_words.bias = stamp_ns, bias

    def take_corrected(self, stamp_ns: int, imu: ImuSample) -> Command | None:
        """Fly on a sample of imu/corrected, unless it is late or its observer is not trusted yet."""
        clean = samples.sanitised(imu)
        if not clean.attitude_valid:
            self._count("imu/corrected: no attitude")
        elif self._monitor.is_late(stamp_ns):
            self._count("imu/corrected: late")
        elif self._monitor.use_corrected(stamp_ns, self._is_starting(stamp_ns, clean)):
            self._last_words.corrected = stamp_ns, clean
            return self._fly_on(stamp_ns, clean, Mode.FULL)
        return None

    def _is_starting(self, stamp_ns: int, corrected: ImuSample) -> bool:
        """Whether the fault observer is back, but not of use yet."""
        if not self._monitor.undiagnosed:
            return False
        return self._last_words.starting or self._transfer.contradicts(stamp_ns, corrected)

    def needs_raw(self, stamp_ns: int, data: bytes) -> bool:
        """Note imu/data, serialised; return whether to fly on it: pass it to `take_raw`, then."""
        self._last_words.raws.append((stamp_ns, data))
        had_diagnosis = not self._monitor.undiagnosed
        needed = self._monitor.use_raw(stamp_ns)
        if needed and had_diagnosis:
            self._lose_diagnosis(stamp_ns)
        return needed

    def take_raw(self, stamp_ns: int, imu: ImuSample) -> Command | None:
        """Fly on a sample of imu/data, without diagnosis."""
        clean = samples.sanitised(imu)
        if not clean.attitude_valid:
            self._count("imu/data: no attitude")
            return None
        return self._fly_on(stamp_ns, clean, Mode.NO_DIAGNOSIS)

    def watch(self, now_ns: int) -> Command | None:
        """Act when samples have stopped coming, by a clock [ns]: hold the torque, later command zero."""
        if self.stamp_ns != self._watched_ns:
            self._watched_ns, self._silent_since_ns = self.stamp_ns, now_ns
        mode = self._monitor.silence(seconds(now_ns - self._silent_since_ns))
        if mode is Mode.FULL or not self.stamp_ns:
            return None
        torque = self._held.mean if mode is Mode.HOLD else np.zeros(3)
        return self._without_law(self.stamp_ns, torque, mode)

    def fly(
        self,
        stamp_ns: int,
        imu: ImuSample,
        wanted: AttitudeCommand,
        disturbance: Vector,
        speeds: Components | None = None,
        effectiveness: Components | None = None,
        mode: Mode = Mode.FULL,
    ) -> Command | None:
        """Step the law; None for a stamp that is refused (repeated, or earlier than the last).

        ``speeds`` (n,) [rad/s] are those measured, None if they are not; ``effectiveness`` (n,) [1] is there
        in free flight.
        """
        inputs = AttitudeLoopInputs(imu, wanted, disturbance, self._torque)
        if self._flies:
            measured = np.bool_(speeds is not None)
            speeds = np.zeros_like(self._healthy) if speeds is None else speeds
            inputs = inputs._replace(speeds=speeds, measured=measured, effectiveness=effectiveness)
        replaced = self._stepper.replaced
        said = self._stepper.step(stamp_ns, inputs)
        if said is None:
            return None
        if self._stepper.replaced > replaced:
            self._count("the controller gave no number: the last torque is held")
        said = self._faded(stamp_ns, inputs, said)
        if self._next is not None:
            self._law, self._next = self._next, None
            self._stepper.law = self._law.without_estimate(self._missing)
            new = self._stepper.begin(stamp_ns, inputs)
            self._fade.begin(stamp_ns, said.output.torque - new.output.torque)
            said = self._faded(stamp_ns, inputs, new)
        self._held.add(stamp_ns, said.output.torque)
        return self._command(stamp_ns, said, mode)

    def _faded(
        self, stamp_ns: int, inputs: AttitudeLoopInputs, said: AttitudeLoopOutput
    ) -> AttitudeLoopOutput:
        """Add to the torque what is left of the difference between two laws."""
        left = self._fade.at(stamp_ns)
        if left is None:
            return said
        torque, _ = limited(self._law.vehicle, said.output.torque + left, inputs.effectiveness)
        output = said.output._replace(torque=torque)
        return self._law.actuated(inputs.command.thrust, output, inputs.effectiveness)

    def _fly_on(self, stamp_ns: int, imu: ImuSample, mode: Mode) -> Command | None:
        """Fly on a clean sample, with the latest of all else."""
        if self.wanted is None:
            self._count("no attitude/reference yet")
            return None
        if self._stepper.time_step(stamp_ns) is None:
            return None  # repeated: imu/corrected of a sample that imu/data has served already
        if self._mode is Mode.OFF and not self._monitor.is_back(stamp_ns):
            return self._without_law(stamp_ns, np.zeros(3), Mode.OFF)
        # The disturbance estimate fades when it gets old; the switching gain takes over its share.
        disturbance, share, trusted = self._monitor.disturbance_at(stamp_ns)
        if not trusted:
            mode = Mode.NO_DISTURBANCE_ESTIMATE if mode is Mode.FULL else mode
            if self._trusted:
                self.kept.append(("disturbance", *self._monitor.estimate))
        self._trusted = trusted
        if self._missing != 1.0 - share:
            self._missing = 1.0 - share
            self._stepper.law = self._law.without_estimate(self._missing)
        # What is flown on goes over from one IMU to the other without a jump.
        flown = self._transfer.used(stamp_ns, imu, mode is Mode.NO_DIAGNOSIS)
        if mode is Mode.NO_DIAGNOSIS:
            self._keep_fault(stamp_ns, imu, flown)
        speeds = self._speeds_at(stamp_ns)
        return self.fly(stamp_ns, flown, self.wanted, disturbance, speeds, self.effectiveness, mode)

    def _speeds_at(self, stamp_ns: int) -> Components | None:
        """Return the latest rotor speeds [rad/s]; None if they are old, or never came."""
        if self._speeds is None or abs(seconds(stamp_ns - self._speeds[0])) > ROTORS_AGE:
            return None
        return self._speeds[1]

    def _lose_diagnosis(self, stamp_ns: int) -> None:
        """Keep what a fault observer that restarts needs, and tell the transfer what is known of imu/data."""
        self._status = None
        self._transfer.expect(None, None)
        if (words := self._last_words.recall(stamp_ns)) is None:
            return
        self._status, last_ns, correction = words
        fault = self._reader.faulty_part(self._status)
        self._transfer.expect(correction, fault if fault.any() and samples.is_usable(fault) else None)
        kept = self._last_words.gyro_correction(last_ns, correction)
        self.kept += [("gyro", last_ns, kept), ("fault", last_ns, self._status)]

    def _keep_fault(self, stamp_ns: int, read: ImuSample, flown: ImuSample) -> None:
        """Keep what the fault has become, as far as that shows without a diagnosis."""
        if self._status is None or not self._transfer.known:
            return
        if (fault := self._last_words.average_fault(stamp_ns, read, flown)) is not None:
            self._reader.revise(self._status, stamp_ns, fault, self._monitor.patience.jump)
            self.kept.append(("fault", stamp_ns, self._status))

    def _without_law(self, stamp_ns: int, torque: Vector, mode: Mode) -> Command:
        """Command a torque [N m] and, unless in mode off, the thrust as last wanted."""
        thrust = 0.0 if mode is Mode.OFF or self.wanted is None else self.wanted.thrust
        said = self._law.actuated(thrust, nothing_but(torque), self.effectiveness)
        return self._command(stamp_ns, said, mode)

    def _command(self, stamp_ns: int, said: AttitudeLoopOutput, mode: Mode) -> Command:
        self._torque, self.stamp_ns, self._mode = said.output.torque, stamp_ns, mode
        return Command(stamp_ns, said.output, mode, said.speeds)

    def _loop_of(self, law: Controller) -> AttitudeLoop:
        return AttitudeLoop(controller=law, flies=self._flies)

    @property
    def _healthy(self) -> Components:
        """Effectiveness of rotors that are healthy."""
        return np.ones(len(self._law.vehicle.rotors.positions))
