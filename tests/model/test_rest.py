"""Robots that are curved at rest: the shape itself, and a prior about it."""

import numpy as np
import pytest

from draws import sixes
from glissando import Grid, StrainReadings, estimate, load_robot
from glissando.errors import RobotFileError
from glissando.geometry import se3
from glissando.model.priors.rest_shape import RestShape
from glissando.model.priors.separable import BaseVariance, SeparablePrior

LENGTH, JOINT = 0.4, 0.15
STRAIN = np.array([[0, 0, 1, 2.0, -3.0, 0.5], [0, 0, 1.02, -1.0, 4.0, 0.2]])
SLOPE = np.array([[0, 0, 0, -12.0, 5.0, 2.0], [0, 0, 0.1, 15.0, -3.0, 0]])
REST = RestShape(STRAIN, SLOPE, np.array([JOINT]))
SOFT = np.repeat([1e-4, 1.0], 3)
PRIOR = SeparablePrior(
    np.tile(SOFT, (2, 1)),
    0.5,
    BaseVariance(np.repeat([1e-6, 1e-4], 3), np.repeat([1e-4, 4.0], 3)),
    rest_strain=STRAIN,
    rest_slope=SLOPE,
    joints=REST.joints,
    jumps=np.repeat([1e-6, 9.0], 3)[None],
)


def walked(arclength, steps=4000):
    """Poses (M, 4, 4) by many small steps from the base: the slow way."""
    out = []
    for s in arclength:
        ends = np.sort(np.append(np.linspace(0.0, s, steps), min(JOINT, s)))
        middle = 0.5 * (ends[1:] + ends[:-1])
        pose = np.eye(4)
        for step in se3.exp(np.diff(ends)[:, None] * REST.at(middle)):
            pose = pose @ step
        out.append(pose)
    return np.array(out)


def test_strain_is_linear_inside_segments_and_jumps_between_them():
    s = np.array([0.0, 0.1, JOINT - 1e-8, JOINT, 0.3])
    expected = [STRAIN[0], STRAIN[0] + 0.1 * SLOPE[0], STRAIN[0] + JOINT * SLOPE[0], STRAIN[1]]
    expected.append(STRAIN[1] + 0.15 * SLOPE[1])
    np.testing.assert_allclose(REST.at(s), expected, atol=1e-7)


@pytest.mark.parametrize(("nodes", "within"), [(5, 2e-4), (9, 2e-5), (17, 2e-6)])
def test_without_readings_the_robot_is_expected_at_rest_at_nodes_and_between(nodes, within):
    """The error falls with the fourth power of the distance of nodes."""
    arclength = np.unique(np.round(np.append(np.linspace(0.0, LENGTH, nodes), JOINT), 9))
    posterior = estimate(PRIOR, Grid(arclength, [0.0, 0.1, 0.2]), [])
    s = np.linspace(0.0, LENGTH, 23)
    at = posterior.at(s, 0.13)
    assert np.abs(at.pose - walked(s, 1000)).max() < within
    np.testing.assert_allclose(at.strain, REST.at(s), atol=1e-12)
    assert np.abs(at.velocity).max() < 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_curving_the_rest_shape_shifts_strains_and_leaves_their_covariance(seed):
    """Strain is linear in the prior: readings that shift with it find what they found before."""
    rng = np.random.default_rng(seed)
    grid = Grid(np.array([0.0, 0.07, JOINT, 0.3, LENGTH]), [0.0, 0.2, 0.4])
    s, t = rng.uniform(0.0, LENGTH, 6), rng.uniform(0.0, 0.4, 6)
    off = sixes(rng, 6, reach=0.01, angle=0.5)

    def judged(prior):
        rest = prior.rest.at(s)
        cov = np.repeat([1e-4, 0.01], 3)
        reading = StrainReadings(time=t, arclength=s, values=rest + off, cov=cov)
        at = estimate(prior, grid, [reading]).at([0.05, JOINT, 0.35], 0.3)
        return at.strain - prior.rest.at(np.array([0.05, JOINT, 0.35])), at.cov[:, 6:12, 6:12]

    straight = SeparablePrior(
        PRIOR.psd_strain_arclength, PRIOR.time_scale, PRIOR.base, joints=PRIOR.joints,
        jumps=PRIOR.jumps,
    )  # fmt: skip
    (mean, cov), (expected, expected_cov) = judged(PRIOR), judged(straight)
    np.testing.assert_allclose(mean, expected, atol=0.01)
    found, expected = (np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in (cov, expected_cov))
    np.testing.assert_allclose(found, expected, rtol=0.01)


FILE = """
name = "bent"
length = 0.4
{rest}
[grid]
arclength_nodes = 5
time_rate = 10.0
[base]
{base}
[prior]
{prior}
"""
SEPARABLE = {
    "base": "var_pose = [1e-6, 1e-4]\nvar_strain = [1e-4, 1.0]",
    "prior": """kind = "separable"
time_scale = 0.5
joints = [0.15]
psd_strain_arclength = [[1e-4, 1.0], [1e-4, 1.0]]
var_jumps = [[1e-6, 9.0]]""",
}
KINEMATIC = {
    "base": "psd_pose = [1, 1]\npsd_strain = [1, 1]\npsd_velocity = [1, 1]",
    "prior": """kind = "white-noise"
psd_velocity_time = [1, 1]
psd_strain_arclength = [1, 1]
psd_strain_time = [1, 1]
psd_velocity_arclength = [1, 1]""",
}


def written(tmp_path, rest, parts):
    file = tmp_path / "bent.toml"
    file.write_text(FILE.format(rest=rest, **parts))
    return file


def test_a_robot_file_gives_the_rest_shape_by_segments(tmp_path):
    rest = f"rest_strain = {STRAIN.tolist()}\nrest_slope = {SLOPE.tolist()}"
    prior = load_robot(written(tmp_path, rest, SEPARABLE)).prior
    np.testing.assert_array_equal(
        prior.rest.at(np.array([0.0, 0.3])), REST.at(np.array([0.0, 0.3]))
    )
    one = load_robot(written(tmp_path, "rest_strain = [0, 0, 1, 0, 2, 0]", SEPARABLE)).prior
    np.testing.assert_array_equal(one.rest.at(np.array([0.3]))[0], [0, 0, 1, 0, 2, 0])


@pytest.mark.parametrize(
    ("rest", "parts", "complaint"),
    [
        (f"rest_strain = {STRAIN.tolist()}", KINEMATIC, 'takes \\[prior\\] kind = "separable"'),
        ("rest_slope = [0, 0, 0, 1, 0, 0]", KINEMATIC, 'takes \\[prior\\] kind = "separable"'),
        (f"rest_strain = {STRAIN[:1].tolist()}", SEPARABLE, "give 2 rows"),
    ],
)
def test_a_rest_shape_that_does_not_fit_is_refused(tmp_path, rest, parts, complaint):
    with pytest.raises(RobotFileError, match=complaint):
        load_robot(written(tmp_path, rest, parts))
