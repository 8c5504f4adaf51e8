"""Waiting for what other processes do."""

import time


def until(happened, within=30.0):
    """What a function returns once it is true; an error when it is not in time."""
    deadline = time.monotonic() + within
    while not (out := happened()):
        assert time.monotonic() < deadline, "it has not happened in time"
        time.sleep(0.002)
    return out
