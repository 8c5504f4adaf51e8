"""Calibration: constants of a rig and of a robot, from recorded data."""
