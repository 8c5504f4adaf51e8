"""The evidence is that of readings under a Gaussian prior, normalised whatever its numbers are."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import (
    FixedLagSmoother,
    Grid,
    PoseReadings,
    PositionReadings,
    estimate,
    load_robot,
)
from glissando.errors import UnobservableError
from glissando.estimation import evidence
from glissando.estimation.evidence import log_normalizer
from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate
from glissando.solver.normal_equations import system_shape

STIFFNESS = np.array([300.0, 300.0, 800.0, 3e-3, 3e-3, 7e-3])
STD = np.repeat([1e-3, 0.01], 3)


def rod(mass=0.01, stiffness=1.0, time_scale=0.3, load=1.0, gravity=(1.0, 0.0, 9.0)):
    """A hanging rod of half a metre; loads and stiffness by their factors."""
    mechanics = Mechanics(stiffness * STIFFNESS, mass, gravity=np.array(gravity))
    psd, error = load * np.repeat([1e-4, 1e-8], 3), np.repeat([1e-7, 1e-3], 3)
    var = np.repeat([1e-4, 1e-8], 3)
    return MechanicalPrior(mechanics, psd, error, var, time_scale, np.repeat([1e-6, 1e-4], 3))


def kinematic(arclength=1.0, motion=1.0, base=True):
    """The shipped robot's prior with densities by their factors."""
    prior = load_robot("tdcr466").prior
    return replace(
        prior,
        psd_strain_arclength=arclength * prior.psd_strain_arclength,
        psd_strain_time=motion * prior.psd_strain_time,
        base=prior.base if base else None,
    )


def segments(strain=1.0, time_scale=0.5):
    """The shipped robot of two segments with its numbers changed."""
    prior = load_robot("tdcr466-segments").prior
    psd = strain * prior.psd_strain_arclength
    return replace(prior, psd_strain_arclength=psd, time_scale=time_scale)


def grid(prior, count=4):
    length = 0.5 if isinstance(prior, MechanicalPrior) else 0.466
    return Grid(np.union1d(np.linspace(0.0, length, 4), prior.joints), 0.2 * np.arange(count))


@pytest.mark.parametrize(
    ("make", "changes"),
    [
        (rod, [{"mass": 0.05}, {"stiffness": 3.0}, {"time_scale": 1.0}, {"load": 10.0}]),
        (rod, [{"gravity": (0.0, 9.8, 0.0)}, {"gravity": (0.0, 0.0, -9.8)}]),
        (kinematic, [{"arclength": 3.0}, {"motion": 3.0}]),
        (segments, [{"strain": 3.0}, {"time_scale": 1.5}]),
    ],
)
def test_a_reading_that_says_nothing_favours_no_robot(make, changes):
    logs = []
    for change in ({}, *changes):
        nodes = grid(make(**change))
        nothing = PositionReadings(time=[0.2], arclength=nodes.arclength[-1],
                                   values=[[0.0, 0.0, 0.4]], cov=1e4)  # fmt: skip
        logs.append(estimate(make(**change), nodes, [nothing]).log_evidence)
    np.testing.assert_allclose(logs, logs[0], atol=0.02)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("make", [rod, kinematic, segments])
def test_evidence_is_that_of_a_dense_gaussian(make, seed):
    """Tips near where the prior has them, so that all is linear, under numbers drawn at random."""
    rng = np.random.default_rng(seed)
    names = {rod: ("mass", "load"), kinematic: ("arclength", "motion"), segments: ("strain",)}
    base = {"mass": 0.01}
    differences = []
    for _ in range(2):
        prior = make(**{n: base.get(n, 1.0) * np.exp(rng.normal()) for n in names[make]})
        nodes = grid(prior)
        rest, last = prior.rest_state(nodes), nodes.arclength.size - 1
        off = 0.02 * STD * rng.standard_normal((nodes.time.size, 6))
        values = rest.pose[:, -1] @ se3.exp(off)
        coil = PoseReadings(time=nodes.time, arclength=nodes.arclength[-1], values=values,
                            cov=STD**2)  # fmt: skip
        found = estimate(prior, nodes, [coil])
        workspace = np.empty(system_shape(nodes.time.size, rest.numbers))
        alone = linearize(prior, locate(nodes, [], ()), rest, rest, workspace).system
        size, dof = alone.diagonal.shape[1], rest.dof
        dense = np.zeros((nodes.time.size, size) * 2)
        for k, block in enumerate(alone.diagonal):
            dense[k, :, k] = block
        for k, block in enumerate(alone.lower):
            dense[k + 1, :, k], dense[k, :, k + 1] = block, block.T
        cov = np.linalg.inv(dense.reshape(nodes.time.size * size, -1))
        tips = (size * np.arange(nodes.time.size)[:, None] + last * dof + np.arange(6)).ravel()
        marginal = cov[np.ix_(tips, tips)] + np.diag(np.tile(STD**2, nodes.time.size))
        fit = off.ravel() @ np.linalg.solve(marginal, off.ravel())
        expected = -0.5 * (fit + np.linalg.slogdet(marginal)[1])
        differences.append(found.log_evidence - expected)
    np.testing.assert_allclose(differences, 0.0, atol=0.02)


@pytest.mark.parametrize("make", [rod, kinematic, segments])
def test_what_normalises_a_prior_is_the_same_by_a_square_root(make, monkeypatch):
    """By which it is found where the normal equations have no digits."""
    prior = make()
    nodes = grid(prior)
    at = nodes, prior.rest_state(nodes), prior.rest_state(nodes)
    expected = log_normalizer(prior, *at)

    def no_digits(*arguments):
        raise UnobservableError("no digits")

    monkeypatch.setattr(evidence, "factor", no_digits)
    assert log_normalizer(prior, *at) == pytest.approx(expected, abs=1e-3)


def test_a_window_has_no_evidence():
    prior = segments()
    smoother = FixedLagSmoother(prior, grid(prior).arclength)
    smoother.advance(0.0)
    assert np.isnan(smoother.posterior().log_evidence)


def test_a_prior_without_a_base_is_compared_by_what_it_says_of_the_rest():
    """Readings of poses all along a straight robot are likelier the less it is said to bend."""
    logs = []
    for change in (0.3, 1.0, 3.0):
        prior = kinematic(arclength=change, base=False)
        nodes = grid(prior)
        still = np.tile(np.eye(4), (nodes.time.size, 1, 1))
        streams = []
        for place in nodes.arclength:
            still[:, 2, 3] = place
            read = {"arclength": place, "values": still.copy(), "cov": 1e-6}
            streams.append(PoseReadings(time=nodes.time, name=f"at {place:.2f}", **read))
        logs.append(estimate(prior, nodes, streams, gate=None).log_evidence)
    assert logs[0] > logs[1] > logs[2] > logs[0] - 100.0
