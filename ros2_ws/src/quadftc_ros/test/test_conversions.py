"""Messages and arrays: there and back without loss, absent channels as REP-145 marks them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from message_objects import ImuWriter, ReferenceWriter, VectorWriter, imu_sample, reference_of, set_stamp
from quadftc_bags.cdr.message import leading_stamp_ns
from quadftc_model.samples import AttitudeReference, ImuSample
from quadftc_msgs.msg import AttitudeReference as AttitudeReferenceMessage
from quadftc_ros.conversions import array_of, stamp_of, time_message

STAMPS = st.integers(0, 2**31 * 10**9 - 1)
VECTORS = arrays(np.float64, 3, elements=st.floats())
FLAGS = st.booleans().map(np.bool_)


@given(STAMPS)
def test_stamp_survives_every_form_it_takes(stamp_ns):
    header = Header()
    set_stamp(header, stamp_ns)
    assert stamp_of(header) == stamp_ns
    assert header.stamp == time_message(stamp_ns)
    message = VectorWriter("map")(stamp_ns, np.zeros(3))
    assert stamp_of(message) == leading_stamp_ns(serialize_message(message)) == stamp_ns


@given(STAMPS, arrays(np.float64, 4, elements=st.floats()), VECTORS, VECTORS, FLAGS, FLAGS, FLAGS)
def test_sample_survives_the_wire_bit_for_bit(stamp_ns, q_xyzw, rate, force, attitude, turning, pushed):
    sample = ImuSample(q_xyzw, rate, force, attitude, turning, pushed)
    message = deserialize_message(serialize_message(ImuWriter()(stamp_ns, sample)), Imu)
    again = imu_sample(message)
    for before, after in zip(sample, again, strict=True):
        np.testing.assert_array_equal(before, after)
    assert (stamp_of(message), message.header.frame_id) == (stamp_ns, "imu_link")


@pytest.mark.parametrize("channel", ["orientation", "angular_velocity", "linear_acceleration"])
def test_absent_channel_is_marked_by_its_covariance_and_others_are_unknown(channel):
    message = Imu()
    getattr(message, f"{channel}_covariance")[0] = -1.0
    valid = imu_sample(message)[3:]
    names = ("orientation", "angular_velocity", "linear_acceleration")
    assert dict(zip(names, valid, strict=True)) == {name: name != channel for name in names}


def test_mark_of_an_absent_channel_does_not_stay_with_the_writer():
    good = ImuSample(*(np.zeros(n) for n in (4, 3, 3)), *(np.bool_(True),) * 3)
    write = ImuWriter()
    write(1, good._replace(rate_valid=np.bool_(False)))
    assert imu_sample(write(2, good)).rate_valid


@given(STAMPS, VECTORS, VECTORS, VECTORS)
def test_reference_survives_the_wire_bit_for_bit(stamp_ns, angles, rates, accelerations):
    reference = AttitudeReference(angles, rates, accelerations)
    wire = serialize_message(ReferenceWriter()(stamp_ns, reference))
    message = deserialize_message(wire, AttitudeReferenceMessage)
    for before, after in zip(reference, reference_of(message), strict=True):
        np.testing.assert_array_equal(before, after)
    assert stamp_of(message) == stamp_ns


@given(VECTORS)
def test_vector_survives(vector):
    message = VectorWriter("base_link")(1, vector)
    np.testing.assert_array_equal(array_of(message.vector), vector)
    assert message.header.frame_id == "base_link"
