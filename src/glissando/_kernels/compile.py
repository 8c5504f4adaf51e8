"""A process that compiles some kernels: `python -m glissando._kernels.compile CLAIMS NAME …`."""

from __future__ import annotations

import sys
from pathlib import Path

from glissando._kernels import (  # noqa: F401  (importing them makes their kernels known)
    block_tridiagonal,
    information,
    intervals,
    matern,
    normal_equations,
    process,
    rod_flow,
    rod_forces,
    rod_intervals,
    rod_motion,
    rod_tip,
    rolls,
    se3,
    sensors,
    state,
    static_steps,
    stationary,
    steps,
    transitions,
    white_noise,
    white_noise_points,
    window,
)
from glissando._kernels.jit import compile_named

if __name__ == "__main__":
    compile_named(Path(sys.argv[1]), sys.argv[2:])
