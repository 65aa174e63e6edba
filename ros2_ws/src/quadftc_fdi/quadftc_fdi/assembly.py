"""The observers from the parameters of their nodes.

Parameters of both nodes, ``fault_observer`` and ``disturbance_observer``: vehicle, observer (its name), and
``<observer>.<parameter>`` for each parameter of that observer. Other parameters are ignored.
"""

from __future__ import annotations

from quadftc_fdi.disturbance_observer import DisturbanceObserver, disturbance_observers
from quadftc_fdi.fault_observer import FaultObserver, fault_observers
from quadftc_model.assembly import NodeParameters, component_from, vehicle_from


def fault_observer_from(parameters: NodeParameters) -> FaultObserver:
    """Build the fault observer; run it with :class:`quadftc_fdi.diagnosis.Diagnosis`.

    Raises
    ------
    ValueError
        Naming the parameter that is wrong.
    """
    return component_from(fault_observers, parameters, "observer", vehicle=vehicle_from(parameters))


def disturbance_observer_from(parameters: NodeParameters) -> DisturbanceObserver:
    """Build the disturbance observer; run it with :class:`quadftc_model.stepper.Stepper`.

    Raises
    ------
    ValueError
        Naming the parameter that is wrong.
    """
    return component_from(disturbance_observers, parameters, "observer", vehicle=vehicle_from(parameters))
