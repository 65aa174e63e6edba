"""Serialised reports of the diagnosis, for a graph and for a bag that is written without ROS."""

from __future__ import annotations

from quadftc_bags.cdr.writer import MessageWriter
from quadftc_model.samples import DiagnosisReport
from quadftc_ros.topics import IMU_FRAME


class DiagnosisWire:
    """Makes serialised reports on all components."""

    def __init__(self, frame: str = IMU_FRAME) -> None:
        self._frame = frame

    def __call__(self, report: DiagnosisReport) -> bytes:
        """Return the message of a report."""
        writer = MessageWriter(report.stamp_ns, self._frame)
        writer.texts(report.watched)
        writer.number("I", len(report.faults))
        for fault in report.faults:
            writer.text(fault.component)
            writer.text(fault.element)
            writer.text(fault.kind)
            writer.number("B", fault.state)
            writer.number("d", fault.size)
            writer.number("d", fault.std_dev)
            writer.text(fault.unit)
            writer.number("d", fault.probability)
            writer.texts(fault.ambiguous_with)
            writer.time(fault.onset_ns)
        return writer.data
