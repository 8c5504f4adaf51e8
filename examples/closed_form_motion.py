"""Write a recording of a motion known in closed form: an arc that bends while its plane turns.

A five-degree-of-freedom coil slides 60 mm back and forth behind the tip; a gyroscope sits half way;
truth frames stand every quarter of the length. Usage: closed_form_motion.py FOLDER [SEED]
"""

import sys
from pathlib import Path

import numpy as np

from glissando.geometry import se3
from glissando.io.csv_stream import Rows, write_named

LENGTH, DURATION, STROKE, PERIOD = 0.466, 8.0, 0.06, 5.0
COIL_STD, GYRO_STD = np.array([7e-4, 7e-4, 7e-4, 6e-3, 6e-3]), np.full(3, 2e-3)


def strain(time):
    """Strain (M, 6) of the arc: curvature swells, the bending plane turns."""
    bend, plane = 2.0 + 1.5 * np.sin(0.8 * time), 0.6 * time
    zero = np.zeros_like(time)
    return np.stack([zero, zero, zero + 1, bend * np.cos(plane), bend * np.sin(plane), zero], -1)


def pose(arclength, time):
    """Pose (M, 4, 4) on a constant-curvature arc: exp(s strain)."""
    return se3.exp(np.asarray(arclength)[:, None] * strain(time))


def angular_velocity(arclength, time, step=1e-5):
    """Body angular velocity (M, 3) by a central difference of the closed form."""
    turn = se3.inverse(pose(arclength, time - step)) @ pose(arclength, time + step)
    return se3.log(turn)[:, 3:] / (2 * step)


def main(folder, seed=0):
    """Write the streams and their description into `folder`."""
    rng = np.random.default_rng(seed)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)

    time = np.arange(0.0, DURATION, 1 / 40)
    phase = np.abs(2.0 * (time / PERIOD % 1.0) - 1.0)  # a triangle wave: constant speed
    place = LENGTH - STROKE * (1.0 - phase)
    noise = np.column_stack([COIL_STD * rng.standard_normal((time.size, 5)), np.zeros(time.size)])
    roll = np.zeros((time.size, 6))
    roll[:, 5] = rng.uniform(-np.pi, np.pi)  # the coil does not see its roll: any will do
    coil = pose(place, time) @ se3.exp(noise) @ se3.exp(roll)
    write_named(folder / "coil.csv", Rows("coil", time, place, coil, {}))

    time = np.arange(0.0, DURATION, 1 / 31)
    middle = np.full(time.size, LENGTH / 2)
    rate = angular_velocity(middle, time) + GYRO_STD * rng.standard_normal((time.size, 3))
    write_named(folder / "gyro.csv", Rows("gyro", time, middle, rate, {}))

    for quarter in (1, 2, 3, 4):
        time = np.arange(0.0, DURATION, 1 / 16)
        at = np.full(time.size, LENGTH * quarter / 4)
        rows = Rows("pose", time, at, pose(at, time), {})
        write_named(folder / f"truth{quarter}.csv", rows)

    streams = [("coil", "coil", COIL_STD, False), ("gyro", "gyro", GYRO_STD, False)]
    streams += [(f"truth{i}", "pose", None, True) for i in (1, 2, 3, 4)]
    text = 'name = "closed form motion"\nrobot = "tdcr466"\n'
    for name, kind, std, truth in streams:
        text += f'\n[[streams]]\nname = "{name}"\nkind = "{kind}"\n'
        text += "truth = true\n" if truth else f"std = {std.tolist()}\n"
    (folder / "recording.toml").write_text(text)
    print(f"Wrote {DURATION:g} s of motion to {folder}")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(sys.argv[1], *(int(a) for a in sys.argv[2:3]))
