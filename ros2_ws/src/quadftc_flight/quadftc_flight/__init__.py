"""Scenarios, the closed loop without ROS, the node graph, metrics and runs."""
