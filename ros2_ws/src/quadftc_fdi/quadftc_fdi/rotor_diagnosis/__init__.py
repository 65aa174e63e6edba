"""Effectiveness of each rotor from gyro, accelerometer and rotor speeds."""
