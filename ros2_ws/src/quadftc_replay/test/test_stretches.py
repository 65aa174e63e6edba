"""Recordings that are replayed in stretches: what the nodes say of the same samples, one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadftc_compile.engine import CEngine
from quadftc_compile.wiring import BLOCK
from quadftc_fdi.diagnosis import Diagnosis
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import ImuSample
from quadftc_replay.diagnose import diagnose
from quadftc_replay.imu_recording import Recording, clean_samples
from quadftc_replay.overlay import faults_from
from quadftc_replay.plan import choose_observer
from quadftc_sim.injector import FaultInjector

COUNT = BLOCK + 700
SEED = 3
FAULTS = (
    "bias axis=roll value=2deg start=1s stop=4s",
    "noise channel=gyro axis=z sigma=0.1 start=2s",
    "delay channel=accelerometer delay=12ms start=1s stop=9s",
    "dropout channel=imu probability=0.2 start=3s stop=8s",
    "nan channel=gyro axis=x start=9s stop=9.1s",
)


def recording() -> Recording:
    """A turn, sampled unevenly, with a gap after which laws restart, and readings that are not there."""
    random = np.random.default_rng(7)
    step_ns = random.integers(3_000_000, 5_000_000, COUNT)
    step_ns[1] = 4_000_000
    step_ns[1500] = 1_500_000_000
    stamps = 7_000_000_000 + np.cumsum(step_ns)
    time = (stamps - stamps[0])[:, None] * 1e-9
    angles = 0.1 * np.sin(np.array([1.0, 2.0, 3.0]) * time)
    rate = 0.1 + 0.01 * random.standard_normal((COUNT, 3))
    force = np.array([0.0, 0.0, 9.81]) + 0.1 * random.standard_normal((COUNT, 3))
    there = np.ones(COUNT, np.bool_)
    imu = ImuSample(quaternion_from_euler(angles), rate, force, random.random(COUNT) > 0.01, there, there)
    return Recording(
        name="flight",
        path=Path("flight"),
        topic="/imu/data",
        namespace="/",
        stamp_ns=stamps,
        imu=clean_samples(imu, stamps, "flight")[0],
        torque=0.01 * random.standard_normal((COUNT, 3)),
        torque_topic="torque/command",
    )


def leaves(tree):
    if isinstance(tree, tuple):
        return [leaf for each in tree for leaf in leaves(each)]
    return [] if tree is None else [tree]


@pytest.mark.parametrize("observer", ["sliding_mode", "supervised"])
def test_a_stretch_says_what_the_nodes_say_sample_by_sample(observer):
    source, law = recording(), choose_observer(recording(), observer).law
    injections = [fault.injection for fault in faults_from([], FAULTS)]
    found = diagnose(source, law, injections, SEED)
    injector = FaultInjector(SEED, injections, engine=CEngine())
    diagnosis, reports = Diagnosis(law, CEngine()), []
    for row, stamp_ns in enumerate(source.stamp_ns.tolist()):
        faulty = injector.apply(stamp_ns, ImuSample(*(column[row] for column in source.imu)))
        assert found.delivered[row] == faulty.present
        if not faulty.present:
            assert np.isnan(found.estimate.fault[row]).all()
            continue
        said = diagnosis.diagnose(stamp_ns, faulty.sample, source.torque[row])
        reports += filter(None, [diagnosis.report(stamp_ns, said)])
        expected = leaves((faulty.sample, *faulty[2:5], *said[:5]))
        columns = leaves((found.seen, *found.overlaid.values(), *found.estimate[:5]))
        for column, value in zip(columns, expected, strict=True):
            np.testing.assert_array_equal(column[row], value)
    assert 0 < np.sum(~found.delivered) < COUNT
    assert found.unusable == diagnosis.replaced
    assert len(found.reports) > 50
    assert found.reports == reports


def test_the_reference_says_the_same_to_rounding():
    source, law = recording(), choose_observer(recording(), "sliding_mode").law
    injections = [fault.injection for fault in faults_from([], FAULTS)]
    one, other = (diagnose(source, law, injections, SEED, engine) for engine in ("c", "numpy"))
    for a, b in zip(leaves(one.estimate), leaves(other.estimate), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
