"""What a diagnosis was worth, in the words of the field; ``summary["metrics"]["diagnosis"]``.

A *fault event* is a time in which one axis of the attitude is faulty by schedule. An axis is *declared*
faulty in the states FAULTY and RECOVERING, *trusted* in HEALTHY and SUSPECT. It is *healthy* outside its
events and the grace after each (``GRACE_TIME``). Every metric: docs/diagnosis.md.
"""

from quadftc_flight.diagnosis_metrics.fault_statistics import pool
from quadftc_flight.diagnosis_metrics.verdicts import diagnosis_metrics
from quadftc_flight.diagnosis_metrics.which_sensor import GRACE_TIME, sensor_metrics

__all__ = ["GRACE_TIME", "diagnosis_metrics", "pool", "sensor_metrics"]
