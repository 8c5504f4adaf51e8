"""Estimators from readings to posterior: batch, fixed-lag, static shapes."""
