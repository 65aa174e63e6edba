"""The node graph: its plan, in one process or a process for each node."""
