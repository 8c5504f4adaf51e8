"""Device drivers, simulated devices, capture of a rig's readings, and live estimation."""
