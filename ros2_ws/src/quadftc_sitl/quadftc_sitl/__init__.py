"""Real autopilots in the loop: their firmware flies the plant, with faults."""
