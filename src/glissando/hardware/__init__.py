"""Drivers, simulated devices, and the capture of all of them together."""
