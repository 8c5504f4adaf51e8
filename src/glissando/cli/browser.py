"""A view of the robot in a browser while a command runs."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from glissando.cli.say import say
from glissando.visualization.page import Live

_POINTS = 41  # along the robot


def browser_view(length: float, stack: ExitStack) -> Live:
    """Serve a view of a robot of `length` m until the stack closes, and print its address."""
    view = stack.enter_context(Live(np.linspace(0.0, length, _POINTS)))
    say(f"Look at {view.address}")
    return view
