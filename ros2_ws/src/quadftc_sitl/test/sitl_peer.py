"""A stand-in for ArduPilot's simulation: its packets, its serial port, a controller of the vehicle.

It takes its behaviour from the parameter ``PEER`` of the file ``--defaults``: 0 flies, the others fail.
"""

import contextlib
import json
import math
import socket
import struct
import sys
import threading
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

FLIES, ENDS, REFUSES, IS_A_PLANE, STOPS = range(5)
RATE, ARM = 100, 0.174  # Hz, m


def options(arguments):
    return dict(zip(arguments[0::2], arguments[1::2], strict=True))


def parameters(file):
    return {name: float(value) for name, value in map(str.split, Path(file).read_text().splitlines())}


class Peer:
    def __init__(self, arguments):
        given = options(arguments)
        self.parameters = {"SIM_GYR1_BIAS_X": 0.0, **parameters(given["--defaults"])}
        self.way = int(self.parameters.get("PEER", FLIES))
        self.physics = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.physics.connect(("127.0.0.1", int(given["--sim-port-out"])))
        self.physics.settimeout(30.0)
        self.serial = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.serial.connect(("127.0.0.1", int(given["--serial0"].split(":")[2])))
        self.serial.setblocking(False)
        self.open = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.open.bind(("0.0.0.0", int(given["--rc-in-port"])))
        self.mavlink = dialect.MAVLink(self, srcSystem=1, srcComponent=1)
        self.armed, self.mode, self.biased = False, 0, False
        self.goal, self.speed, self.yaw = np.zeros(3), np.zeros(3), math.pi / 2
        self.home, self.integral = None, 0.0
        self.pulses = [1000] * 4

    def write(self, data):
        with contextlib.suppress(OSError):
            self.serial.send(data)

    def run(self):
        for count in range(10**9):
            if self.way == STOPS and count == 50:
                threading.Event().wait()
            self.physics.send(struct.pack("<HHI16H", 18458, RATE, count, *self.pulses, *[0] * 12))
            state = json.loads(self.physics.recv(4096))
            self.step(count, state)

    def step(self, number, state):
        time = int(1e3 * state["timestamp"])
        if number % 10 == 0:
            kind = dialect.MAV_TYPE_FIXED_WING if self.way == IS_A_PLANE else dialect.MAV_TYPE_QUADROTOR
            self.mavlink.heartbeat_send(kind, 3, 1 | 128 * self.armed, self.mode, 4)
        if number % 10 == 1:
            x, y, z = np.subtract(state["position"], self.home) if self.home is not None else (0.0,) * 3
            self.mavlink.local_position_ned_send(time, x, y, z, *state["velocity"])
            ready = dialect.MAV_SYS_STATUS_PREARM_CHECK * (self.way != REFUSES)
            self.mavlink.sys_status_send(0, 0, ready, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        self.listen()
        if self.home is None:
            self.home = np.array(state["position"])
        if self.biased != (self.parameters["SIM_GYR1_BIAS_X"] != 0.0):
            self.biased = not self.biased
            self.mavlink.statustext_send(2, b"EKF3 lane switch 1")
        self.control(state)

    def listen(self):
        try:
            while True:
                for message in self.mavlink.parse_buffer(self.serial.recv(2048)) or []:
                    getattr(self, f"on_{message.get_type().lower()}", lambda _: None)(message)
        except OSError:
            pass

    def on_command_long(self, message):
        result, number = dialect.MAV_RESULT_ACCEPTED, message.command
        if number == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            if self.way == REFUSES:
                self.mavlink.statustext_send(2, b"Arm: Compass not calibrated")
                result = dialect.MAV_RESULT_FAILED
            else:
                self.armed = True
        elif number == dialect.MAV_CMD_DO_SET_MODE:
            self.mode = int(message.param2)
        elif number == dialect.MAV_CMD_NAV_TAKEOFF:
            self.goal[2] = -message.param7
        self.mavlink.command_ack_send(number, result)

    def on_param_request_read(self, message):
        name = message.param_id
        if name in self.parameters:
            self.mavlink.param_value_send(name.encode(), self.parameters[name], 9, 1, 0)

    def on_param_set(self, message):
        self.parameters[message.param_id] = message.param_value
        self.on_param_request_read(message)

    def on_set_position_target_local_ned(self, message):
        self.goal = np.array([message.x, message.y, message.z])
        self.speed = np.array([message.vx, message.vy, message.vz])
        self.yaw = message.yaw

    def control(self, state):
        """PD on the position, on the thrust's direction and on the yaw; north, east, down."""
        if not self.armed:
            self.pulses = [1000] * 4
            return
        position, velocity = np.subtract(state["position"], self.home), np.array(state["velocity"])
        if self.mode in (6, 9):  # RTL, LAND
            self.goal = np.array([position[0], position[1], min(0.3, self.goal[2] + 0.5 / RATE)])
            self.speed = np.array([0.0, 0.0, 0.5])
            if position[2] > -0.05 and abs(velocity[2]) < 0.1:
                self.armed = False
                return
        push = 2.0 * (self.goal - position) + 2.5 * (self.speed - velocity)
        self.integral = float(np.clip(self.integral + 0.5 / RATE * (self.goal[2] - position[2]), -2, 2))
        push[:2] = np.clip(push[:2], -3.0, 3.0)
        thrust = 9.81 - np.clip(push[2] + self.integral, -4.0, 4.0)
        w, x, y, z = state["quaternion"]
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
        ahead = push[0] * math.cos(yaw) + push[1] * math.sin(yaw)
        right = -push[0] * math.sin(yaw) + push[1] * math.cos(yaw)
        p, q, r = state["imu"]["gyro"]
        turn = math.remainder(self.yaw - yaw, 2 * math.pi)
        a = 0.02389 * (60.0 * (right / 9.81 - roll) - 12.0 * p) / (4 * ARM)
        b = 0.02389 * (60.0 * (-ahead / 9.81 - pitch) - 12.0 * q) / (4 * ARM)
        c = float(np.clip(0.044 * (4.0 * turn - 4.0 * r) / (4 * 0.016), -0.5, 0.5))
        each = 2.0643 * thrust / 4 / math.cos(roll) / math.cos(pitch)
        forces = [each - a + b + c, each + a - b + c, each + a + b - c, each - a - b - c]
        shares = np.sqrt(np.clip(np.array(forces) / 8.54858, 0.0225, 1.0))
        self.pulses = [round(1000 + 1000 * share) for share in shares]


def main():
    peer = Peer(sys.argv[1:])
    if peer.way == ENDS:
        sys.exit("panic: no such thing")
    peer.run()


if __name__ == "__main__":
    main()
