"""Confidence is true on shapes of another group's solver, learned on others of them."""

from pathlib import Path

import numpy as np
import pytest

import shapes
from sorosim import FILE


@pytest.fixture(scope="module")
def poses():
    file = Path(__file__).parents[2] / FILE
    if not file.is_file():
        pytest.skip("SoroSim's shapes are not beside the checkout")
    return shapes.load_shapes(file)


@pytest.mark.slow
def test_what_was_learned_on_some_shapes_predicts_others(poses):
    assert set(shapes.TUNED_ON) <= set(range(250))
    assert set(shapes.REPORTED_ON) == set(range(250, 500))
    judged = shapes.judge(shapes.LEARNED, shapes.read_shapes(poses, shapes.REPORTED_ON))
    told = shapes.summary(judged)
    assert told["stations"] == 7 * 250
    assert 0.92 <= told[0.95][0] <= 0.98
    assert 0.42 <= told[0.5][0] <= 0.58
    for where in (True, ~judged.beyond, judged.beyond):
        (median, rmse), (their_median, their_rmse) = (
            shapes.summary(judged, where)[name] for name in ("ours", "hermite")
        )
        assert median < their_median
        assert rmse < their_rmse


def test_a_coil_reads_five_stations_as_noisy_as_it_says(poses):
    """Its places and axes, turned about themselves, are those of the shape."""
    read = shapes.read_shapes(poses, range(250))
    for shape in read[:3]:
        assert sorted([*shape.stops, *shape.unread]) == list(range(1, 13))
    true = np.concatenate([shape.pose[shape.stops] for shape in read])
    coil = np.concatenate([shape.coil for shape in read])
    gap = coil[:, :3, 3] - true[:, :3, 3]
    tilt = np.cross(true[:, :3, 2], coil[:, :3, 2])
    assert np.sqrt(np.mean(gap**2)) == pytest.approx(0.7e-3, rel=0.05)
    assert np.sqrt(np.mean(np.sum(tilt**2, axis=1)) / 2) == pytest.approx(np.radians(0.4), rel=0.05)
