"""The published form reproduces the reference implementation; ours is then compared with it.

The golden posterior was made by the reference implementation of the published prior (C++, batch,
published settings); its rows marked 'tight' are converged. Poses are the outside truth here.
"""

import csv

import numpy as np
import pytest

from glissando.evaluation.run import run_estimate
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording
from oracles import published

WINDOW = (19.0, 29.0)
STREAMS = ("aurora0", "aurora1", "gyro_mid", "gyro_ee")


@pytest.fixture(scope="module")
def reference(golden):
    with golden.open() as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        tight = [row for row in rows if row["run"] == "tight"]

    def columns(*names):
        return np.array([[float(row[name]) for name in names] for row in tight])

    pose = np.tile(np.eye(4), (len(tight), 1, 1))
    rotation = [f"R{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
    pose[:, :3, :3] = columns(*rotation).reshape(-1, 3, 3)
    pose[:, :3, 3] = columns("px", "py", "pz")
    return columns("s")[:, 0], columns("t")[:, 0], pose, columns(*(f"P{i}" for i in range(1, 7)))


@pytest.fixture(scope="module")
def oracle(spacetime):
    folder = spacetime / "slow_free_space"
    streams = []
    for name in STREAMS:
        kind, time, place, values = published.read_stream(folder / f"{name}.csv")
        keep = (time >= WINDOW[0]) & (time <= WINDOW[1])
        streams.append((kind, time[keep], place[keep], values[keep]))
    times = published.published_times(streams, *WINDOW, 301)
    arclength = np.linspace(0.0, 0.466, 5)
    return published.solve_published(streams, arclength, times, published.Settings())


def gaps(poses, others):
    """Distance (mm) and angle (degrees) between poses."""
    apart = se3.log(se3.inverse(poses) @ others)
    distance = np.linalg.norm(poses[:, :3, 3] - others[:, :3, 3], axis=1)
    return 1e3 * distance, np.degrees(np.linalg.norm(apart[:, 3:], axis=1))


@pytest.mark.slow
def test_the_published_form_reproduces_the_reference_posterior(reference, oracle):
    s, t, pose, variance = reference
    mm, degrees = gaps(oracle.pose_at(s, t), pose)
    tip = s > 0.465
    print(
        f"oracle against reference: tip {mm[tip].max():.4f} mm, {degrees[tip].max():.4f} deg; "
        f"elsewhere {mm[~tip].max():.4f} mm, {degrees[~tip].max():.4f} deg"
    )
    assert mm.max() < 0.01
    assert degrees.max() < 0.01
    ours = np.array(
        [np.diag(oracle.pose_covariance_at(*at)) for at in zip(s[tip], t[tip], strict=True)]
    )
    ratio = np.sqrt(ours / variance[tip])
    print("ratio of standard deviations at the tip:", np.round([ratio.min(), ratio.max()], 3))
    assert ratio == pytest.approx(np.ones_like(ratio), rel=0.01)


@pytest.mark.slow
def test_ours_differs_from_the_published_form_by_less_than_its_confidence(spacetime, oracle):
    """Its standard deviations are about a fifth larger, and that is the point.

    Along the body because exact transitions do not shrink on a coarse grid as the published rows
    do (10.52 against 12.68 mm in the bent-rod scene on five nodes); at the tip because a tracker's
    repeated rows, counted again there, are dropped here, readings between nodes are inflated, and
    its time nodes stand elsewhere (they end at the last reading, not at the window's end).
    """
    recording = load_recording(spacetime / "slow_free_space")
    run = run_estimate(recording, recording.robot, window=WINDOW, use=None, truth=None)
    s = np.repeat([0.1165, 0.233, 0.3495, 0.466], 2)
    t = np.tile([20.0, 28.0], 4)
    at = run.posterior.at(s, t)
    mm, degrees = gaps(at.pose, oracle.pose_at(s, t))
    share = mm / (1e3 * at.std_position)
    theirs = [
        np.trace(oracle.pose_covariance_at(*point)[:3, :3]) for point in zip(s, t, strict=True)
    ]
    ratio = at.std_position / np.sqrt(theirs)
    for place in np.unique(s):
        here = s == place
        print(
            f"s = {place:.4f} m: ours differs by {mm[here].max():.2f} mm and "
            f"{degrees[here].max():.2f} deg at most; standard deviation "
            f"{ratio[here].min():.2f} to {ratio[here].max():.2f} of the published form's"
        )
    assert share.max() < 0.35
    assert np.all((ratio > 0.8) & (ratio < 1.6))
