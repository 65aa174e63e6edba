"""Long tests of the software itself, `scripts/soak`: faults put into the programs, at random times."""
