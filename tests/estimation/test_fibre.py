"""Fibres tell bending along the axes of the body and no torsion, which stays as the prior says."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import (
    BaseVariance,
    FbgReadings,
    FixedLagSmoother,
    Grid,
    SeparablePrior,
    StrainReadings,
    estimate,
    estimate_static,
)
from glissando.errors import SensorError
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.outcome import Outcome

LENGTH = 0.5
NODES = np.linspace(0.0, LENGTH, 5)
TIME = np.arange(0.0, 2.0, 0.1)
PRIOR = SeparablePrior(
    psd_strain_arclength=np.array([1e-7, 1e-7, 1.6e-5, 4.6, 4.6, 0.3]),
    time_scale=0.5,
    base=BaseVariance(
        pose=np.repeat([2.6e-6, 4e-4], 3), strain=np.array([1e-7, 1e-7, 6e-4, 27.0, 27.0, 1.1])
    ),
)
BENDING, TORSION = slice(3, 5), 5


def bending(time, arclength):
    """The two curvatures (…, 2), 1/m, of a robot that bends by 150 to 300 degrees, untwisted."""
    one = 2.0 * np.cos(0.4 * np.pi * time) * np.cos(3.0 * arclength / LENGTH)
    other = (3.0 + 3.0 * np.sin(0.5 * np.pi * time)) * (0.5 + arclength / LENGTH)
    return np.stack(np.broadcast_arrays(one, other), axis=-1)


def places(moments):
    """Moments and arclengths of readings at twenty places along the robot."""
    return (each.ravel() for each in np.meshgrid(moments, (np.arange(20) + 0.5) * 0.025))


def fibre(time, place, u):
    """A fibre of three cores and a centre core, with noise, in a robot of curvatures (M, 2)."""
    radius, angle = np.array([35e-6] * 3 + [0.0]), np.array([0.0, 2.0, 4.0, 0.0]) * np.pi / 3.0
    u = u[:, None]
    strain = radius * (u[..., 0] * np.sin(angle) - u[..., 1] * np.cos(angle))
    strain += 2e-6 * np.random.default_rng(0).standard_normal(strain.shape)
    cores = {"core_radius": radius, "core_angle": angle}
    return FbgReadings(time=time, arclength=place, values=strain, cov=(2e-5) ** 2, **cores)


def cross_sections(time, place, u):
    """The same bends as strains of cross-sections, of which the torsion is hardly known."""
    values = np.zeros((time.size, 6))
    values[:, 2], values[:, BENDING] = 1.0, u
    cov = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 100.0]) ** 2
    return StrainReadings(time=time, arclength=place, values=values, cov=cov)


def of_batch(readings):
    return estimate(PRIOR, Grid(NODES, TIME), [readings]).at(NODES, TIME[:, None]).strain


def of_loop(readings):
    smoother, seen = FixedLagSmoother(PRIOR, NODES, window=5), []
    for time in TIME:
        smoother.add(readings.select(readings.time == time))
        smoother.advance(time)
        seen.append(smoother.at(NODES, time).strain)
    return np.array(seen)


@pytest.mark.parametrize("sensor", [fibre, cross_sections])
@pytest.mark.parametrize("estimated", [of_batch, of_loop])
def test_bending_along_the_body_does_not_twist_it(sensor, estimated):
    time, place = places(TIME)
    strain = estimated(sensor(time, place, bending(time, place)))
    assert np.abs(strain[..., TORSION]).max() < 0.3
    middle = NODES[1:-1]
    true = bending(TIME[:, None], middle)
    assert np.abs(strain[:, 1:-1, BENDING] - true).max() < 1.0


def test_static_shapes_that_wind_at_random_are_not_twisted_either():
    rng, count = np.random.default_rng(0), 30
    winding = replace(PRIOR, psd_strain_arclength=PRIOR.psd_strain_arclength * 4.0)
    number, place = places(np.arange(float(count)))
    walk = 5.0 * rng.standard_normal((1, count, 2))
    walk = walk + np.cumsum(0.7 * rng.standard_normal((20, count, 2)), axis=0)
    readings = replace(fibre(number, place, walk.reshape(-1, 2)), cov=(2e-6) ** 2)
    shapes = estimate_static(winding, NODES, [readings])
    torsion = shapes.at(NODES, np.arange(count)[:, None]).strain[..., TORSION]
    assert np.sqrt(np.mean(torsion**2)) < 0.05


def test_microstrain_in_the_place_of_strain_is_refused_in_a_sentence():
    time, place = places(TIME)
    of = fibre(time, place, bending(time, place))
    with pytest.raises(SensorError, match=r"core 0 in row \d+ is -?\d+.*1e-6 times microstrain"):
        replace(of, values=1e6 * of.values)


def test_shapes_of_precise_fibres_are_found_in_a_few_steps():
    rng, count = np.random.default_rng(1), 20
    number, place = places(np.arange(float(count)))
    waves = np.cos(np.pi / LENGTH * place[:, None] * np.arange(3))
    sizes = np.array([5.0, 2.5, 1.2]) * rng.standard_normal((2, count, 3))[:, number.astype(int)]
    u = np.sum(sizes * waves, axis=-1).T
    readings = replace(fibre(number, place, u), cov=(2e-6) ** 2)
    nodes, steps = np.linspace(0.0, LENGTH, 21), SolverOptions(max_iterations=6)
    winding = replace(PRIOR, psd_strain_arclength=PRIOR.psd_strain_arclength * 4.0)
    winding = replace(winding, base=replace(PRIOR.base, pose=np.repeat([1e-8, 1e-6], 3)))
    assert estimate_static(winding, nodes, [readings], options=steps).converged.all()
    for k in range(3):
        one = readings.select(number == k).changed(time=np.zeros(20))
        report = estimate(winding, Grid(nodes, [0.0]), [one], options=steps).solve
        assert report.outcome is Outcome.CONVERGED
        assert report.iterations <= 6
