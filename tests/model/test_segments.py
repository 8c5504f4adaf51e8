"""A body of segments: strain may vary differently in each, and jump at the joint between two."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from draws import prior as kinematic
from glissando import (
    BaseDensity,
    Grid,
    GyroReadings,
    PoseReadings,
    SolverOptions,
    State,
    WhiteNoisePrior,
    estimate,
)
from glissando.errors import OutsideGridError
from glissando.geometry import se3
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.model.priors.prior import by_interval
from glissando.model.priors.prior_table import segments_table
from glissando.model.priors.separable import BaseVariance, SeparablePrior

EXACT = SolverOptions(tolerance=1e-8)
PRIORS = {
    "kinematic": kinematic(),
    "separable": SeparablePrior(
        kinematic().psd_strain_arclength,
        0.8,
        BaseVariance(np.full(6, 1e-3), np.array([1e-3] * 3 + [2.0] * 3)),
    ),
}
BOTH = pytest.mark.parametrize("kind", PRIORS)
GRID = Grid([0.0, 0.1, 0.2, 0.3, 0.4], [0.0, 0.1, 0.25])


def in_two(prior, jump, *, joint=0.2):
    """The same robot as two equal segments with a joint of variance `jump` between them."""
    psd = np.stack([prior.psd_strain_arclength] * 2)
    return replace(prior, psd_strain_arclength=psd, joints=np.array([joint]), jumps=jump)


def swinging(bend):
    """Readings of poses and a gyroscope of a robot bent by `bend` times about half a radian."""
    time, place = np.repeat(GRID.time, 2), np.tile([0.15, 0.4], 3)
    strain = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) + bend * np.stack(
        [0 * time, 0 * time, 0 * time, 1.0 + 2 * time, 0.7 - time, 3.0 * place], axis=-1
    )
    spin = bend * np.array([[0.8, -0.4, 0.0]] * 3)
    return [
        PoseReadings(
            time=time,
            arclength=place,
            values=se3.exp(place[:, None] * strain),
            cov=[1e-6] * 3 + [1e-4] * 3,
        ),
        GyroReadings(time=GRID.time, arclength=np.full(3, 0.4), values=spin, cov=1e-2),
    ]


def apart(one, other):
    """Largest difference of means and of covariances in standard deviations of the second."""
    std = np.sqrt(np.einsum("mii->mi", other.cov))
    states = (State(e.pose, e.strain, e.velocity) for e in (one, other))
    mean = next(states).difference(next(states)) / std
    cov = (one.cov - other.cov) / std[:, :, None] / std[:, None, :]
    return np.abs(mean).max(), np.abs(cov).max()


def change_by_segments(kind, jump, bend):
    s, t = map(np.ravel, np.meshgrid([0.0, 0.05, 0.15, 0.2, 0.27, 0.4], [0.0, 0.07, 0.1, 0.2]))
    priors = PRIORS[kind], in_two(PRIORS[kind], np.full((1, 6), jump))
    found = [estimate(p, GRID, swinging(bend), options=EXACT).at(s, t) for p in priors]
    return apart(*found[::-1])


@BOTH
@pytest.mark.parametrize("bend", [0.01, 1.0])
def test_segments_alike_without_a_jump_are_one(kind, bend):
    mean, cov = change_by_segments(kind, 0.0, bend)
    assert max(mean, cov) < 1e-9


@BOTH
@pytest.mark.parametrize("bend", [1e-6, 0.1, 1.0])
def test_segments_alike_with_hardly_a_jump_are_nearly_one(kind, bend):
    mean, cov = change_by_segments(kind, 1e-12, bend)
    assert mean < 1e-5
    assert cov < 1e-5


@BOTH
def test_strain_jumps_at_the_joint_and_nowhere_else(kind):
    """Curvatures seen on both sides of the joint are believed where a jump may be."""
    free = in_two(PRIORS[kind], np.array([[1e-3] * 3 + [25.0] * 3]))
    readings = swinging(1.0)
    near = 1e-9 * np.array([-1e3, 0.0, 1e3])  # the node's own strain is the one beyond
    for prior, jumps in ((PRIORS[kind], False), (free, True)):
        posterior = estimate(prior, GRID, readings)
        for joint in (0.1, 0.2, 0.3):
            at = posterior.at(joint + near, 0.1)
            before, behind = np.abs(np.diff(at.strain[:, 3:], axis=0)).max(axis=1)
            wider = np.diag(at.cov[1])[9:12] / np.diag(at.cov[0])[9:12]
            assert behind < 1e-3
            if jumps and joint == 0.2:
                assert before > 0.1
            else:
                assert before < 1e-3
                assert wider == pytest.approx(np.ones(3), abs=1e-3)
            assert at.pose[0] == pytest.approx(at.pose[2], abs=1e-5)


@BOTH
@pytest.mark.parametrize("joint", [0.1, 0.25])
def test_a_joint_that_is_no_node_is_named_with_the_nearest(kind, joint):
    prior = in_two(PRIORS[kind], np.ones((1, 6)), joint=joint)
    grid = Grid([0.0, 0.16, 0.32, 0.4], [0.0, 0.1])
    near = {0.1: "0.16", 0.25: "0.32"}[joint]
    sentence = rf"joint at {joint:g} m, which is not an arclength node .* nearest is {near} m"
    with pytest.raises(OutsideGridError, match=sentence):
        estimate(prior, grid, [])


@BOTH
def test_a_shape_with_a_jump_keeps_its_poses_when_a_step_bends_it(kind):
    """Poses that follow from their strains stay where they are when the step is nothing."""
    prior = in_two(PRIORS[kind], np.full((1, 6), 1e9))
    first, then = np.array([[0, 0, 1.0, 1.0, 0.5, 0.2], [0, 0, 1.0, -2.0, 1.0, 0.3]])
    state = prior.rest_state(GRID)
    strain = np.where(GRID.arclength[:, None] < 0.2, first, then)
    place = GRID.arclength[:, None]
    pose = se3.exp(np.minimum(place, 0.2) * first) @ se3.exp(np.maximum(place - 0.2, 0.0) * then)
    bent = replace(
        state,
        pose=np.broadcast_to(pose, state.pose.shape).copy(),
        strain=np.broadcast_to(strain, state.strain.shape).copy(),
    )
    step = np.zeros((*GRID.shape, state.dof))
    found = prior.retract_strains(GRID, bent, step)
    np.testing.assert_allclose(found.pose, bent.pose, atol=1e-8)


# Bodies whose curvature truly jumps

LENGTH, JOINT, TRIALS = 0.5, 0.25, 100
NODES = np.linspace(0.0, LENGTH, 9)
INSIDE = np.array([1e-8, 1e-8, 1e-8, 2e-4, 2e-4, 2e-4])  # density of strain within a segment
FIRST = np.array([1e-6, 1e-6, 1e-6, 0.8, 0.8, 0.2])  # variance of the first segment's strain
JUMP = np.array([1e-6, 1e-6, 1e-6, 3.0, 3.0, 0.2])
FIRM = np.array([1e-6] * 3 + [1e-5] * 3)
POSE_COV = np.array([1e-6] * 3 + [1e-4] * 3)
READ = np.array([0.08, 0.15, 0.22, 0.28, 0.35, 0.42, 0.5])
JUDGED = np.array([0.0, 0.1, 0.1875, 0.24, 0.25, 0.26, 0.3125, 0.4, 0.5])


def body(kind, *, segments):
    """A prior of the body: segments that hardly bend within and jump, or one as free in all."""
    spread = INSIDE + JUMP / LENGTH  # as much over the whole length
    more = {"joints": np.array([JOINT]), "jumps": JUMP[None]} if segments else {}
    psd = np.stack([INSIDE, INSIDE]) if segments else spread
    if kind == "separable":
        return SeparablePrior(psd, 1.0, BaseVariance(FIRM, FIRST), **more)
    firm = BaseDensity(FIRM, FIRST, np.ones(6))
    one = np.ones(6)
    return WhiteNoisePrior(one, psd, one, one, firm, **more)


def draw(rng):
    """Strain (9, 6) and pose at the judged places and poses at the read ones, exactly integrated.

    Strain is constant within both segments, as the segments' prior says but for a little.
    """
    first = np.array([0, 0, 1.0, 0, 0, 0]) + np.sqrt(FIRST) * rng.standard_normal(6)
    then = first + np.sqrt(JUMP) * rng.standard_normal(6)
    base = se3.exp(np.sqrt(FIRM) * rng.standard_normal(6))

    def pose(s):
        s = s[:, None]
        near, far = np.minimum(s, JOINT) * first, np.maximum(s - JOINT, 0.0) * then
        return base @ se3.exp(near) @ se3.exp(far)

    strain = np.where(JUDGED[:, None] < JOINT, first, then)
    noise = np.sqrt(POSE_COV) * rng.standard_normal((READ.size, 6))
    seen = pose(READ) @ se3.exp(noise)
    readings = PoseReadings(time=np.zeros(READ.size), arclength=READ, values=seen, cov=POSE_COV)
    return pose(JUDGED), strain, readings


@pytest.mark.filterwarnings("ignore::glissando.errors.FalseConfidenceWarning")
@pytest.mark.slow
@BOTH
def test_segments_know_a_jump_that_one_body_smears(kind):
    priors = {"segments": body(kind, segments=True), "one body": body(kind, segments=False)}
    grid, rng = Grid(NODES, [0.0]), np.random.default_rng(21)
    off = {name: [] for name in priors}
    nees = {name: [] for name in priors}
    for _ in range(TRIALS):
        pose, strain, readings = draw(rng)
        for name, prior in priors.items():
            at = estimate(prior, grid, [readings]).at(JUDGED, 0.0)
            turn = se3.log(se3.inverse(at.pose) @ pose)
            miss = np.concatenate([turn, strain - at.strain], axis=-1)
            off[name].append(np.linalg.norm(miss[:, 9:], axis=-1))
            white = np.linalg.solve(at.cov[:, :12, :12], miss[..., None])[..., 0]
            nees[name].append(np.einsum("mi,mi->m", miss, white))
    rms = {name: np.sqrt(np.mean(np.square(each), axis=0)) for name, each in off.items()}
    mean = {name: np.mean(each, axis=0) / 12 for name, each in nees.items()}
    low, high = chi2.ppf([0.5e-4, 1 - 0.5e-4], 12 * TRIALS) / 12 / TRIALS
    print(f"{kind}, at s =", JUDGED)
    for name in priors:
        print(f"{name:>9}: curvature off by", np.round(rms[name], 2), "rad/m rms")
        print(f"{name:>9}: NEES a degree  ", np.round(mean[name], 2), f"in {low:.2f}, {high:.2f}")
    assert np.all((mean["segments"] > low) & (mean["segments"] < high))
    assert not np.all((mean["one body"] > low) & (mean["one body"] < high))
    assert np.all(rms["segments"] < 0.7 * rms["one body"])


# Saving


@BOTH
@pytest.mark.parametrize("segments", [False, True], ids=["one body", "two segments"])
def test_a_saved_posterior_gives_the_same_answers(kind, segments, tmp_path):
    pytest.importorskip("xarray")
    prior = in_two(PRIORS[kind], np.full((1, 6), 0.5)) if segments else PRIORS[kind]
    posterior = estimate(prior, GRID, swinging(1.0))
    save_posterior(posterior, tmp_path / "posterior.nc")
    again = load_posterior(tmp_path / "posterior.nc")
    assert type(again.prior) is type(prior)
    for name in ("psd_strain_arclength", "joints", "jumps", "rest_strain", "base_pose"):
        np.testing.assert_array_equal(getattr(again.prior, name), getattr(prior, name))
        assert np.shape(getattr(again.prior, name)) == np.shape(getattr(prior, name))
    s, t = map(np.ravel, np.meshgrid([0.0, 0.17, 0.2, 0.33, 0.4], [0.0, 0.03, 0.1, 0.2]))
    before, after = posterior.at(s, t), again.at(s, t)
    np.testing.assert_allclose(after.pose, before.pose, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(after.strain, before.strain, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(after.velocity, before.velocity, rtol=0.0, atol=1e-13)
    for one, other in zip(after.cov, before.cov, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-9 * np.abs(other).max())
    assert again.solve == posterior.solve
    more = estimate(again.prior, GRID, swinging(1.0), initial=again.state).at(s, t)
    assert max(apart(more, before)) < 1e-2


def test_one_density_of_all_segments_leaves_their_jumps():
    arclength, joints, jumps = np.linspace(0.0, 0.4, 5), np.array([0.2]), np.full((1, 6), 5.0)
    one = np.arange(1.0, 7.0)
    for found, wanted in zip(
        by_interval(arclength, one, joints, jumps),
        by_interval(arclength, np.tile(one, (2, 1)), joints, jumps),
        strict=True,
    ):
        np.testing.assert_array_equal(found, wanted)
    table = segments_table(one, joints, jumps, "var_jumps")
    assert table["var_jumps"] == jumps.tolist()
