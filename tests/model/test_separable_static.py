"""A still robot is known as well whatever the grid and the duration."""

import numpy as np
import pytest

from glissando import BaseDensity, CoilReadings, Grid, WhiteNoisePrior, estimate
from glissando.errors import OutsideGridError
from glissando.geometry import se3
from glissando.model.priors.separable import BaseVariance, SeparablePrior
from oracles import separable as oracle

LENGTH, WATCHED = 0.5, np.array([0.125, 0.25, 0.35, 0.5])
SHAPE = np.array([0.0, 0.0, 1.0, 1.6, -0.8, 0.4])
STATIC_PSD = np.array([1e-3, 1e-3, 1e-3, 10.0, 10.0, 2.0])
STATIC_BASE = BaseVariance(
    np.array([1e-6] * 3 + [1e-4] * 3), np.array([1e-4] * 3 + [4.0, 4.0, 0.5])
)
COIL_COV = np.array([1e-6] * 3 + [1e-4] * 2)


def watched(kind, *, nodes=5, rate=40.0, span=(0.0, 1.0), readings=41, read=(0.0, 1.0)):
    """Standard deviations (4, 18) in the middle of a recording of a still robot's tip coil."""
    if kind == "separable":
        prior = SeparablePrior(STATIC_PSD, 2.0, STATIC_BASE)
    else:  # as wide as the other one for a still shape watched for one second
        prior = WhiteNoisePrior(
            psd_velocity_time=np.array([0.05] * 3 + [2.5] * 3),
            psd_strain_arclength=STATIC_PSD,
            psd_strain_time=0.1 * STATIC_PSD,
            psd_velocity_arclength=np.array([1e-2] * 3 + [1.0] * 3),
            base=BaseDensity(STATIC_BASE.pose, STATIC_BASE.strain, np.full(6, 1e-2)),
        )
    time = np.linspace(*read, readings)
    coil = CoilReadings(
        time=time,
        arclength=np.full(readings, LENGTH),
        values=np.tile(se3.exp(LENGTH * SHAPE), (readings, 1, 1)),
        cov=COIL_COV,
    )
    times = np.linspace(*span, round((span[1] - span[0]) * rate) + 1)
    grid = Grid(np.linspace(0.0, LENGTH, nodes), times)
    at = estimate(prior, grid, [coil] if readings else []).at(WATCHED, 0.5 * sum(span))
    return np.sqrt(np.einsum("mii->mi", at.cov))


DOUBLED = {
    "arclength nodes": {"nodes": 9},
    "time nodes": {"rate": 80.0},
    "duration, as many readings a second": {"span": (0, 2), "readings": 81, "read": (0, 2)},
    "duration, the same readings": {"span": (-0.5, 1.5)},
    "duration, as many readings in all": {"span": (0, 2), "read": (0, 2)},
}


@pytest.mark.slow
@pytest.mark.parametrize("what", DOUBLED)
def test_a_still_robot_is_known_as_well_however_much_is_doubled(what):
    change = {}
    for kind in ("separable", "kinematic"):
        before, behind = watched(kind), watched(kind, **DOUBLED[what])
        change[kind] = np.abs(behind / before - 1.0)
        places = np.linalg.norm(behind[:, :3], axis=1) / np.linalg.norm(before[:, :3], axis=1) - 1
        print(f"{what} doubled, {kind}: std of position changes by", np.round(places, 5))
        fields = change[kind].reshape(4, 3, 6).max(axis=(0, 2))
        print("    at most, of pose, strain, velocity:", np.round(fields, 5))
    if what.endswith("in all"):  # half as many near the middle: the tip itself is known less well
        change = {kind: c[:3, :12] for kind, c in change.items()}
        assert change["separable"].max() < 0.01
    else:
        assert change["separable"].max() < 0.005
    if what != "time nodes":
        assert change["kinematic"].max() > 5.0 * change["separable"].max()


def test_a_robot_nobody_reads_is_known_as_well_however_long():
    change = {}
    for kind in ("separable", "kinematic"):
        std = [watched(kind, rate=10.0, span=(0, last), readings=0) for last in (1, 2, 4)]
        change[kind] = [np.abs(s / std[0] - 1.0).max() for s in std[1:]]
        print(f"{kind}: std changes by", *(f"{c:.1e}" for c in change[kind]), "when 2, 4 times")
    assert max(change["separable"]) < 1e-5
    assert min(change["kinematic"]) > 0.1


def test_time_nodes_so_dense_that_digits_would_be_lost_are_refused():
    """What an information matrix says of differences between neighbours falls as (h/ℓ)³."""
    prior = SeparablePrior(STATIC_PSD, 10.0, STATIC_BASE, rest_strain=SHAPE)
    time = np.linspace(0.0, 1.0, 11)
    process = {
        "psd": STATIC_PSD,
        "base_pose_var": STATIC_BASE.pose,
        "base_strain_var": STATIC_BASE.strain,
        "time_scale": prior.time_scale,
        "rest_strain": SHAPE,
    }
    cov = oracle.joint([*((LENGTH, t) for t in time), (0.25, 0.5)], **process)
    h = np.eye(len(cov))[(24 * np.arange(11)[:, None] + np.arange(5)).ravel()]
    cov = oracle.condition(cov, h, np.zeros(len(h)), np.diag(np.tile(COIL_COV, 11)))[1]
    expected = np.sqrt(np.diag(cov)[-24:-6])
    coil = CoilReadings(
        time=time,
        arclength=np.full(11, LENGTH),
        values=np.tile(se3.exp(LENGTH * SHAPE), (11, 1, 1)),
        cov=COIL_COV,
    )
    for rate in (10, 20):
        grid = Grid(np.linspace(0.0, LENGTH, 9), np.linspace(0.0, 1.0, rate + 1))
        at = estimate(prior, grid, [coil]).at(0.25, 0.5)
        gap = np.abs(np.sqrt(np.diag(at.cov)) / expected - 1.0).max()
        print(f"{rate} nodes a second: std off by {gap:.1e}")
        assert gap < 1e-3
    grid = Grid([0.0, LENGTH], np.linspace(0.0, 1.0, 41))
    with pytest.raises(OutsideGridError, match=r"0.025 s apart are too dense .* leave 0.05 s"):
        estimate(prior, grid, [coil])
