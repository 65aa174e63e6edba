"""The simulated vehicle and its faults: pure core and the plant and fault-injector nodes."""
