"""Free flight by MuJoCo (Todorov, Erez, Tassa 2012), an engine that shares no equation of motion with ours.

The model is made of the vehicle file: a free body, and each rotor a body of its own on a hinge that a servo
turns. So the torque of spinning up and the gyroscopic torque of the rotors come out of MuJoCo's mechanics of
several bodies, as does the accelerometer. Thrust and reaction torque of a rotor act at its site. Drag, the
rotational drag and disturbances are ours and act on the body from outside; MuJoCo's own fluid is off.

Loads are held during each of the ``substeps``, those of the rotors at the speed in its middle. The ground is
MuJoCo's, stiffer than that of `free_flight`. One vehicle at a time: no batch can trace it.
"""

from __future__ import annotations

import importlib
import math
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Components, Vector
from quadftc_model.numbers import prepared
from quadftc_model.parameters import parameter
from quadftc_model.rotations import to_earth
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_sim.flying_plant import FlightState, FlyingPlant, RotorState
from quadftc_sim.plant import register

ROTOR_MASS = 1e-4  # 1; of each rotor over that of the vehicle, to which it is added in the file
LEAST_INERTIA = 1e-6  # 1; of a rotor, over that of the vehicle about z: MuJoCo has no body without
FOOT = 0.1  # 1; radius of a foot over the height of the vehicle's centre
FRICTION = 0.6  # 1; Coulomb friction, as of `free_flight`


class _World(NamedTuple):
    """MuJoCo with the compiled model and a scratch for its state."""

    mujoco: Any
    model: Any
    data: Any


@register("mujoco")
class Mujoco(FlyingPlant):
    """A vehicle that flies in MuJoCo, an optional package: pip install mujoco."""

    traceable = False
    substeps: int = parameter(4, low=1, high=1000, doc="integration steps to a control period")

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self._world  # refuses now what it cannot build

    def step(self, state: FlightState, command: Components, time: float, dt: float) -> FlightState:
        """Advance by ``dt`` [s] from scenario time ``time`` [s] under rotor speeds [rad/s] (n,), held."""
        spin, lag = self.vehicle.rotors.spin_sign, self.motor_lag
        wanted = self.speeds_wanted(state, _one_vehicle(command))
        mujoco, model, data = self._world
        state = state if lag else state._replace(speeds=wanted)
        if dt == 0.0:  # a step that MuJoCo does not do
            return state
        self._set(state)
        model.opt.timestep = step = dt / self.substeps
        left = math.exp(-0.5 * step / self.motor_time_constant) if lag else 0.0
        rotors = state.rotors
        for index in range(self.substeps):
            speeds = wanted + left * (spin * data.qvel[6:] - wanted)  # in the middle of the substep
            half = 0.5 * step * spin * speeds
            rotors = rotors._replace(angle=rotors.angle + half)
            self._load(self._state(speeds, rotors), wanted, time + (index + 0.5) * step)
            mujoco.mj_step(model, data)
            rotors = rotors._replace(angle=rotors.angle + half)
        return self._state(spin * data.qvel[6:] if lag else wanted, rotors)

    def specific_force(self, state: FlightState, time: float) -> Vector:
        """What MuJoCo's accelerometer measures at the place of the IMU [m/s²]."""
        mujoco, model, data = self._world
        self._set(state)
        self._load(state, state.speeds, time)
        mujoco.mj_forward(model, data)
        return data.sensordata.copy()

    def _state(self, speeds: Components, rotors: RotorState) -> FlightState:
        """Return the state that MuJoCo is in, with rotors as given."""
        qpos, qvel = self._world.data.qpos, self._world.data.qvel
        return FlightState(
            qpos[:3].copy(), qvel[:3].copy(), qpos[[4, 5, 6, 3]], qvel[3:6].copy(), speeds, rotors
        )

    def _set(self, state: FlightState) -> None:
        """Take over a state; nothing of what was flown before remains."""
        data, spin = self._world.data, self.vehicle.rotors.spin_sign
        x, y, z, w = _one_vehicle(state.q_xyzw)
        data.qpos[:3], data.qpos[3:7], data.qpos[7:] = state.position, (w, x, y, z), 0.0
        data.qvel[:3], data.qvel[3:6], data.qvel[6:] = state.velocity, state.body_rate, spin * state.speeds
        data.qacc_warmstart[:] = 0.0

    def _load(self, state: FlightState, wanted: Components, time: float) -> None:
        """Set thrusts, servos, and what acts from outside, along the axes of the earth."""
        data, rotors = self._world.data, self.vehicle.rotors
        count = len(wanted)
        thrusts = rotors.thrust_coefficient * state.speeds * state.speeds
        data.ctrl[:count] = state.rotors.condition.effectiveness * thrusts
        data.ctrl[count:] = rotors.spin_sign * wanted
        shake_x, shake_y, yaw = self.shaking(state)
        force = self.drag(state, time) + np.array([shake_x, shake_y, 0.0])
        damping = self.vehicle.rotational_drag * state.body_rate
        torque = self.disturbance(time, state.body_rate) - damping + np.array([0.0, 0.0, yaw])
        data.xfrc_applied[1] = [*to_earth(state.q_xyzw, force), *to_earth(state.q_xyzw, torque)]

    @prepared
    def _world(self) -> _World:
        try:
            mujoco: Any = importlib.import_module("mujoco")
        except ImportError:
            text = "plant 'mujoco': the package mujoco is not installed; expected 'pip install mujoco'"
            raise ValueError(text) from None
        try:
            model = mujoco.MjModel.from_xml_string(self.mjcf)
        except ValueError as error:
            words = " ".join(str(error).split())
            raise ValueError(f"plant 'mujoco', vehicle '{self.vehicle.name}': {words}") from None
        return _World(mujoco, model, mujoco.MjData(model))

    @prepared
    def mjcf(self) -> str:
        """The vehicle as a model of MuJoCo, in its XML format."""
        vehicle, rotors = self.vehicle, self.vehicle.rotors
        xy, count = rotors.positions, len(rotors.positions)
        spin = max(rotors.rotor_inertia, LEAST_INERTIA * self.inertia[2])
        mass = ROTOR_MASS * vehicle.mass
        # the body is what the rotors, as points with moments of their own, leave of the vehicle
        squares = np.sum(xy**2, axis=0)
        taken = mass * np.array([squares[1], squares[0], np.sum(squares)])
        hub = self.inertia - taken - count * spin * np.array([0.5, 0.5, 1.0])
        servo = spin / self.motor_time_constant if self.motor_lag else 0.0
        own = f'mass="{mass:.17g}" diaginertia="{_row([0.5 * spin, 0.5 * spin, spin])}"'
        body, actuators = "", ""
        for index, (x, y) in enumerate(xy.tolist()):
            gear = _row([0.0, 0.0, 1.0, 0.0, 0.0, rotors.torque_to_thrust * rotors.yaw_sign[index]])
            body += (
                f'<site name="rotor_{index}" pos="{x:.17g} {y:.17g} 0"/>'
                f'<body pos="{x:.17g} {y:.17g} 0"><joint type="hinge" axis="0 0 1" name="rotor_{index}"/>'
                f'<inertial pos="0 0 0" {own}/></body>'
            )
            actuators += f'<motor site="rotor_{index}" gear="{gear}"/>'
        actuators += "".join(f'<velocity joint="rotor_{i}" kv="{servo:.17g}"/>' for i in range(count))
        radius = -FOOT * self.feet[0, 2]
        for x, y, z in self.feet.tolist():
            body += f'<geom size="{radius:.17g}" pos="{_row([x, y, z + radius])}"/>'
        return f"""<mujoco>
<compiler angle="radian"/>
<option integrator="RK4" gravity="0 0 {-STANDARD_GRAVITY:.17g}"/>
<default><geom type="sphere" friction="{FRICTION} 0.005 0.0001" contype="{int(self.ground)}"/></default>
<worldbody><geom type="plane" size="0 0 1"/>
<body name="vehicle"><freejoint/>
<inertial pos="0 0 0" mass="{vehicle.mass - count * mass:.17g}" diaginertia="{_row(hub)}"/>
<site name="imu" pos="{_row(vehicle.aerodynamics.imu_position)}"/>{body}</body></worldbody>
<actuator>{actuators}</actuator>
<sensor><accelerometer site="imu"/></sensor>
</mujoco>"""


def _row(numbers: Any) -> str:
    return " ".join(f"{number:.17g}" for number in numbers)


def _one_vehicle(vector: Array) -> Components:
    """Refuse many vehicles at once, and numbers that a compiler traces."""
    if type(vector) is not np.ndarray or np.ndim(vector) != 1:
        raise ValueError(f"plant 'mujoco' flies one vehicle in NumPy, not {type(vector).__name__}")
    return np.asarray(vector)
