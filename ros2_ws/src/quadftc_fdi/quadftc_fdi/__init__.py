"""Fault diagnosis: fault and disturbance observers (pure core) and their nodes."""
