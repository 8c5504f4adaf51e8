"""Devices that are not there: each a process that speaks as the real one does."""
