"""Recorded IMU samples through the diagnosis."""
