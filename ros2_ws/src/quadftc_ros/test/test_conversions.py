"""Stamps: there and back without loss."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from message_objects import VectorWriter, set_stamp
from quadftc_bags.cdr.message import leading_stamp_ns
from quadftc_ros.conversions import stamp_of, time_message

STAMPS = st.integers(0, 2**31 * 10**9 - 1)


@given(STAMPS)
def test_stamp_survives_every_form_it_takes(stamp_ns):
    header = Header()
    set_stamp(header, stamp_ns)
    assert stamp_of(header) == stamp_ns
    assert header.stamp == time_message(stamp_ns)
    message = VectorWriter("map")(stamp_ns, np.zeros(3))
    assert stamp_of(message) == leading_stamp_ns(serialize_message(message)) == stamp_ns
