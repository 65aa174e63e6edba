"""Where the theory holds: conditions per law, isolability, check."""
