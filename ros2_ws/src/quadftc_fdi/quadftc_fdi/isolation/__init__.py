"""Parts of the observer ``isolating``: rate filter, test of the gyro, hypotheses, the accelerometer."""
