"""Tracker frames that are lost while the slide moves, on this machine under its present load.

`python benchmarks/frames.py [RUNS]` records RUNS sessions on simulated devices, three cycles of
60 mm each, which are 670 frames at 40 Hz.
"""

import os
import sys
import tempfile
from pathlib import Path

import numpy as np

from glissando.hardware.capture import capture, simulated_rig
from glissando.io.session_log import read_session
from glissando.io.session_recording import LOG
from glissando.simulation import SlideLimits, SlidePath


def gaps_and_frames(folder: Path) -> tuple[list[int], int]:
    """Numbers of frames lost in each gap of one session, and of frames received."""
    with simulated_rig() as rig:
        assert rig.stage is not None
        limits = SlideLimits(rig.stage.stroke[1], rig.stage.speed, rig.stage.acceleration)
        capture(rig, SlidePath.oscillate(3, 0.06, limits), folder)
    frames = read_session(folder / LOG).topics["/tracker/coil"].column("frame")
    lost = np.diff(frames).astype(int) - 1
    return lost[lost > 0].tolist(), frames.size


def main() -> None:
    """Record sessions and count lost frames."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    lost = total = 0
    for run in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            gaps, received = gaps_and_frames(Path(folder) / "session")
        lost, total = lost + sum(gaps), total + received + sum(gaps)
        gaps_text = f"gaps of {', '.join(map(str, gaps))}" if gaps else "no gap"
        print(f"run {run}: {received} came, {gaps_text}; load {os.getloadavg()[0]:.1f}", flush=True)
    print(f"{lost} of {total} frames lost in {runs} sessions, on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
