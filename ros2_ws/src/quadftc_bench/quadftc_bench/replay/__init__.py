"""Recorded IMU samples through the diagnosis, without ROS in between, with faults overlaid on request.

>>> replay = plan_replay(Path("flight"), ReplayOptions(faults=("bias axis=roll value=3deg start=60s",)))
>>> replay.summary(replay.diagnose())["metrics"]["fault_estimate_rmse_inside_deg"]

`quadftc_bench.replay.ros_output` writes the result as a bag.
"""

from quadftc_bench.replay.plan import Replay, ReplayOptions, plan_replay

__all__ = ["Replay", "ReplayOptions", "plan_replay"]
