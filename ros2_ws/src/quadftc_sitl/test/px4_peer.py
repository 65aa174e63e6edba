"""A stand-in for PX4's simulation: it connects to the simulator API, and flies as `sitl_peer` does.

Behind a gyro without errors it integrates its attitude; places and speeds are those of HIL_GPS.
"""

import math
import re
import socket
import sys
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

sys.path.insert(0, str(Path(__file__).parent))
from sitl_peer import FLIES, REFUSES, STOPS, Peer, parameters

DEGREE = 111318.845  # m
OFFBOARD = 6 << 16
LAND = 4 << 16 | 6 << 24


class PX4Peer(Peer):
    def __init__(self, arguments):
        assert Path(arguments[4]).name == "rcS"
        self.parameters = parameters("parameters.parm")
        self.way = int(self.parameters.get("PEER", FLIES))
        local, remote = re.search(r"-u (\d+) .*-o (\d+) ", Path("px4-rc.mavlink").read_text()).groups()
        self.serial = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.serial.bind(("127.0.0.1", int(local)))
        self.serial.connect(("127.0.0.1", int(remote)))
        self.serial.setblocking(False)
        self.physics = socket.create_connection(("127.0.0.1", 4560 + int(arguments[2])))
        self.mavlink = dialect.MAVLink(self, srcSystem=1, srcComponent=1)
        self.simulator = dialect.MAVLink(self.physics.makefile("wb", buffering=0))
        self.armed, self.mode, self.failing = False, 0, False
        self.goal, self.speed, self.yaw = np.zeros(3), np.zeros(3), math.pi / 2
        self.home, self.integral, self.pulses = np.zeros(3), 0.0, [1000] * 4
        self.q = np.array([0.5**0.5, 0.0, 0.0, 0.5**0.5])  # w, x, y, z; the nose faces east
        self.place = self.velocity = np.zeros(3)
        self.last = self.count = 0

    def run(self):
        while data := self.physics.recv(4096):
            for message in self.simulator.parse_buffer(data) or []:
                getattr(self, f"on_{message.get_type().lower()}")(message)

    def on_hil_gps(self, message):
        width = DEGREE * math.cos(math.radians(47.397742))
        north, east = 1e-7 * message.lat - 47.397742, 1e-7 * message.lon - 8.545594
        self.place = np.array([DEGREE * north, width * east, 488.0 - 1e-3 * message.alt])
        self.velocity = 1e-2 * np.array([message.vn, message.ve, message.vd])

    def on_hil_sensor(self, message):
        if message.id:  # another IMU, which says the same
            return
        self.count += 1
        if self.way == STOPS and self.count > 50:
            return
        rate = np.array([message.xgyro, message.ygyro, message.zgyro])
        dt, self.last = 1e-6 * (message.time_usec - self.last), message.time_usec
        w, v = self.q[0], self.q[1:]
        change = np.concatenate([[-v @ rate], w * rate + np.cross(v, rate)])
        self.q = self.q + 0.5 * min(dt, 0.01) * change
        self.q /= np.linalg.norm(self.q)
        self.place = self.place + min(dt, 0.01) * self.velocity
        self.speak(message.time_usec // 1000)
        self.listen()
        imu = {"gyro": rate}
        self.control({"position": self.place, "velocity": self.velocity, "quaternion": self.q, "imu": imu})
        shares = [max(0.0, (pulse - 1000) / 1000) for pulse in self.pulses]
        self.simulator.hil_actuator_controls_send(message.time_usec, [*shares, *[0.0] * 12], 129, 1)

    def speak(self, time):
        if self.count % 10 == 0:
            self.mavlink.heartbeat_send(2, dialect.MAV_AUTOPILOT_PX4, 1 | 128 * self.armed, self.mode, 4)
        if self.count % 10 == 1:
            self.mavlink.local_position_ned_send(time, *self.place, *self.velocity)
            ready = dialect.MAV_SYS_STATUS_PREARM_CHECK * (self.way != REFUSES)
            self.mavlink.sys_status_send(0, 0, ready, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)

    def on_command_long(self, message):
        result, number = dialect.MAV_RESULT_ACCEPTED, message.command
        if number == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            if self.way == REFUSES:
                self.mavlink.statustext_send(2, b"Preflight Fail: Compass 0 fault\t")
                result = dialect.MAV_RESULT_DENIED
            else:
                self.armed = True
        elif number == dialect.MAV_CMD_DO_SET_MODE:
            self.mode = int(message.param2) << 16 | int(message.param3) << 24
        elif number == dialect.MAV_CMD_INJECT_FAILURE:
            assert (message.param1, message.param3) == (2, 1)  # the first magnetometer
            words = {1.0: b"MAG #0 failed:  TIMEOUT!", 0.0: b"MAG #0 is well"}[message.param2]
            self.mavlink.statustext_send(2 if message.param2 else 6, words)
        self.mavlink.command_ack_send(number, result)

    def control(self, state):
        modes, self.mode = self.mode, 9 if self.mode == LAND else 0
        super().control(state)
        self.mode = modes


if __name__ == "__main__":
    PX4Peer(sys.argv[1:]).run()
