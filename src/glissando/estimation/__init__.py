"""Readings in, posterior out: batch, fixed-lag, static shapes."""
