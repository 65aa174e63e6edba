"""What all nodes share: QoS, parameters, conversions, synchronisation, diagnostics, recorder."""
