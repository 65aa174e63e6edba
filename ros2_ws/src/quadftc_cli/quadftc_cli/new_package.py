"""Packages that ``quadftc new`` writes: one component each, in a ROS 2 package of the user's own."""

from __future__ import annotations

import keyword
import re
from pathlib import Path
from typing import Any, NamedTuple

from quadftc_control.controller import controllers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.registry import Registry
from quadftc_sim.fault import faults


class Kind(NamedTuple):
    """What a kind of component needs."""

    group: str  # of entry points
    depends: str  # the package with its base class
    registry: Registry[Any]
    tests: str  # contract tests, in a clone
    law: str  # the file of the law
    trial: str  # what flies it


def write_package(kind: str, name: str, directory: Path) -> list[Path]:
    """Write a package for a component of a kind into ``directory/NAME``; return its files.

    A ValueError says if the name cannot be used, or the directory exists.
    """
    if kind not in KINDS:
        raise ValueError(f"{kind}: expected one of {', '.join(KINDS)}")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name) or name.startswith("quadftc"):
        raise ValueError(f"{name}: expected small letters, digits and _, as my_{kind}; not quadftc...")
    if name in KINDS[kind].registry.names():
        raise ValueError(f"{name}: the name of a {kind} that exists")
    folder = directory / name
    if folder.exists():
        raise ValueError(f"{folder}: exists")
    row = KINDS[kind]
    words = {
        "@NAME@": name,
        "@CLASS@": "".join(part.capitalize() for part in name.split("_")),
        "@KIND@": kind,
        "@A_KIND@": f"{'An' if kind == 'observer' else 'A'} {kind}",
        "@GROUP@": row.group,
        "@DEPENDS@": row.depends,
        "@TESTS@": row.tests,
    }
    files = {**FILES, f"{name}/{name}.py": row.law, f"{name}/__init__.py": INIT, f"resource/{name}": ""}
    written: list[Path] = []
    for path, text in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        content = re.sub("@[A-Z_]+@", lambda word: words[word[0]], text.replace("@TRIAL@", row.trial))
        file.write_text(content, encoding="utf-8")
        written.append(file)
    return written


OBSERVER = '''"""The fault observer ``@NAME@``: the residual of dead reckoning, washed out.

Put your law in its place.

The gyro carries an attitude x^ on, which the measured attitude y pulls with the time constant T:

    r = y - x^,    x^ <- x^ + g r,    g = dt / (T + dt),    fault estimate (1 - g) r

So a fault shows at once and is forgotten with T, and a gyro bias b leaves an error of b T. The law says
FAULTY where the estimate exceeds the threshold. Beyond 80 deg of pitch it flies on the gyro alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadftc_fdi.fault_observer import FaultObserver, comparable, correct_sample, dead_reckon, register
from quadftc_model.arrays import Quaternion, Vector, namespace
from quadftc_model.parameters import parameter
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import FAULTY, HEALTHY, FaultEstimate, FaultObserverInputs


class @CLASS@State(NamedTuple):
    """Observer state at the last sample."""

    q_xyzw: Quaternion  # x^
    gyro: Vector  # [rad/s]
    fault: Vector  # [rad]
    age: Vector  # how long each axis has been faulty [s]


@register("@NAME@")
class @CLASS@(FaultObserver):
    """Compare the attitude with the gyro, and forget slowly."""

    time_constant: float = parameter(200.0, unit="s", low=1e-3, doc="T: how long a fault is remembered")
    threshold: float = parameter(math.radians(0.2), unit="rad", low=0.0, doc="estimate that is a fault")

    def init(self, inputs: FaultObserverInputs) -> @CLASS@State:
        """Start on the measurement: the sensor counts as healthy at the first sample."""
        rate = inputs.imu.body_rate
        zeros = namespace(rate).zeros_like(rate)
        return @CLASS@State(inputs.imu.q_xyzw, rate, zeros, zeros)

    def step(
        self, state: @CLASS@State, inputs: FaultObserverInputs, dt: float
    ) -> tuple[@CLASS@State, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        # carry the attitude on by the gyro; an absent rate keeps its last value
        gyro = xp.where(imu.rate_valid[..., None], imu.body_rate, state.gyro)
        q_xyzw = dead_reckon(state.q_xyzw, state.gyro, gyro, dt)
        x, y = euler_from_quaternion(q_xyzw), euler_from_quaternion(imu.q_xyzw)
        # pull it to the measurement, where there is one
        usable = imu.attitude_valid[..., None] & comparable(x, y)
        r = xp.where(usable, wrap(y - x), 0.0)
        g = dt / (self.time_constant + dt)
        q_xyzw = xp.where(usable, quaternion_from_euler(x + g * r), q_xyzw)
        # judge what is left; without a measurement, the fault stays what it was
        fault = xp.where(usable, (1.0 - g) * r, state.fault)
        faulty = xp.abs(fault) > self.threshold
        age = xp.where(faulty, state.age + dt, 0.0)
        estimate = FaultEstimate(
            fault=fault,
            std_dev=xp.full_like(fault, -1.0),
            state=xp.where(faulty, FAULTY, HEALTHY).astype(xp.uint8),
            onset_age=xp.where(faulty, age, -1.0),
            corrected=correct_sample(imu, q_xyzw, gyro),
        )
        return @CLASS@State(q_xyzw, gyro, fault, age), estimate
'''

CONTROLLER = '''"""The controller ``@NAME@``: proportional-derivative, the least that holds an attitude.

Put your law in its place.
"""

from typing import Any

from quadftc_control.controller import Controller, limited, register
from quadftc_control.sliding_surface import tracking
from quadftc_model.arrays import namespace
from quadftc_model.parameters import parameter
from quadftc_model.samples import ControllerInputs, ControllerOutput


@register("@NAME@")
class @CLASS@(Controller):
    """Torque from angle and rate error."""

    stiffness: float = parameter(30.0, unit="1/s^2", low=0.0, doc="angular acceleration per angle error")
    damping: float = parameter(10.0, unit="1/s", low=0.0, doc="angular acceleration per rate error")

    def init(self, inputs: ControllerInputs) -> tuple[()]:
        """Return no state."""
        return ()

    def step(self, state: Any, inputs: ControllerInputs, dt: float) -> tuple[Any, ControllerOutput]:
        """Compute the torque for a sample."""
        track = tracking(inputs)
        wanted = -self.vehicle.inertia * (self.stiffness * track.x1e + self.damping * track.x1e_dot)
        given, cut = limited(self.vehicle, wanted)
        return state, ControllerOutput(given, track.x1e, namespace(wanted).zeros_like(wanted), cut)
'''

FAULT = '''"""The fault ``@NAME@``: an offset that comes and goes. Put your law in its place."""

from typing import Any

from quadftc_model.arrays import namespace
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("@NAME@")
class @CLASS@(Fault):
    """value + size in the first half of every period, value in the second."""

    size: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="{channel}", doc="offset")
    period: float = parameter(2.0, unit="s", low=1e-3, doc="time from one offset to the next")

    def step(self, state: Any, inputs: FaultInputs, dt: float) -> tuple[Any, FaultOutput]:
        """Add the offset where it is there."""
        xp = namespace(inputs.value)
        there = inputs.elapsed % self.period < 0.5 * self.period
        return state, present(inputs.value + xp.where(there, 1.0, 0.0) * xp.asarray(self.size))
'''

INIT = '''"""@A_KIND@ for quadftc in a package of its own."""
'''

SETUP = '''"""Build script of @NAME@ (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "@NAME@"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="@A_KIND@ for quadftc.",
    license="Apache-2.0",
    maintainer="you",
    maintainer_email="you@example.com",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    # The name on the left is what scenario files and the command line say.
    entry_points={"@GROUP@": ["@NAME@ = @NAME@.@NAME@:@CLASS@"]},
)
'''

PACKAGE_XML = """<?xml version="1.0"?>
<?xml-model href="http://download.ros.org/schema/package_format3.xsd" schematypens="http://www.w3.org/2001/XMLSchema"?>
<package format="3">
  <name>@NAME@</name>
  <version>0.1.0</version>
  <description>@A_KIND@ for quadftc.</description>
  <maintainer email="you@example.com">you</maintainer>
  <license>Apache-2.0</license>

  <exec_depend>@DEPENDS@</exec_depend>
  <exec_depend>quadftc_model</exec_depend>
  <exec_depend>python3-numpy</exec_depend>

  <export>
    <build_type>ament_python</build_type>
  </export>
</package>
"""

SETUP_CFG = """[develop]
script_dir=$base/lib/@NAME@

[install]
install_scripts=$base/lib/@NAME@
"""

README = """# @NAME@

@A_KIND@ for quadftc: `@NAME@/@NAME@.py`. Build it in a workspace on top of quadftc, whose environment is
sourced:

```
colcon build --packages-select @NAME@ && . install/setup.bash
@TRIAL@
```

In a clone of quadftc, its contract tests run on it, too: `scripts/test ros2_ws/src/@TESTS@ -k @NAME@`.
"""

FILES = {"package.xml": PACKAGE_XML, "setup.py": SETUP, "setup.cfg": SETUP_CFG, "README.md": README}
KINDS = {
    "observer": Kind(
        "quadftc.fault_observers",
        "quadftc_fdi",
        fault_observers,
        "quadftc_fdi/test/test_fault_observer_contract.py",
        OBSERVER,
        "quadftc run paper_faults --observer @NAME@",
    ),
    "controller": Kind(
        "quadftc.controllers",
        "quadftc_control",
        controllers,
        "quadftc_control/test/test_controller_contract.py",
        CONTROLLER,
        "quadftc run paper_faults --controller @NAME@",
    ),
    "fault": Kind(
        "quadftc.faults",
        "quadftc_sim",
        faults,
        "quadftc_sim/test/test_faults.py",
        FAULT,
        "quadftc inject @NAME@ axis=roll size=3deg duration=10s    # into a graph that runs",
    ),
}
