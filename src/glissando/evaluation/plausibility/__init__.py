"""Plausibility checks of readings: units, clocks, frames, axes, noise."""
