"""Calibration of the constants of rigs and robots from recorded data."""
