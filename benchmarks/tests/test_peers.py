"""Static shapes against GTSAM on the same problem, and the curves that stand beside them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

pytest.importorskip("gtsam")

from draws import generators, law
from glissando import BaseDensity, Grid, PoseReadings, State, estimate
from glissando.geometry import se3
from glissando.solver.gauss_newton import SolverOptions
from slope import slope_test

gtsam = pytest.importorskip("gtsam")
peers = pytest.importorskip("peers")

import peers_curves
import peers_gtsam
from oracles.published_static import PublishedStatic
from peers_problems import REPORTED_ON, Numbers, Problem

NUMBERS = Numbers.of(np.array([-3.0, 0.0, -0.5, -3.0, 1.4, 0.0, -3.15, -2.15]))
STATIONS = np.linspace(0.0, 0.6, 13)
READ, ASKED = [3, 6, 9, 12], [1, 2, 4, 5, 7, 8, 10, 11]
ROOT = Path(__file__).parents[2]


def problem_of(rng, count=3, bend=2.0, noise=1.0):
    """Shapes whose curvature wanders along the body, read with the noise that they state."""
    fine = np.linspace(0.0, 0.6, 241)
    phase = rng.uniform(0.0, 2.0 * np.pi, (count, 1, 3))
    strain = np.zeros((count, 240, 6))
    strain[..., 2] = 1.0
    strain[..., 3:] = bend * np.sin(6.0 * fine[:-1, None] + phase) * [1.0, 1.0, 0.3]
    base = se3.exp(rng.standard_normal(6))
    poses = [np.broadcast_to(base, (count, 4, 4))]
    for k in range(240):
        poses.append(poses[-1] @ se3.exp(0.0025 * strain[:, k]))
    poses = np.stack(poses, axis=1)[:, ::20]
    off = noise * NUMBERS.noise * rng.standard_normal((count, len(READ), 6))
    read, every = poses[:, READ] @ se3.exp(off), np.arange(count)
    return Problem(
        "drawn",
        count,
        STATIONS,
        base,
        1e-5,
        np.repeat(every, len(READ)),
        np.tile(STATIONS[READ], count),
        read.reshape(-1, 4, 4),
        np.repeat(every, len(ASKED)),
        np.tile(STATIONS[ASKED], count),
        poses[:, ASKED][..., :3, 3].reshape(-1, 3),
        0.0,
    )


def published(problem):
    """Their factors in a prior of ours."""
    one = np.ones(6)
    base = BaseDensity(np.full(6, problem.base_std**2), NUMBERS.base_strain, one)
    return PublishedStatic(one, NUMBERS.psd, one, one, base, base_pose=problem.base_pose)


def std(cov):
    return np.sqrt(np.einsum("mii->mi", cov))


@pytest.mark.slow
@settings(law, max_examples=5)
@given(generators)
@pytest.mark.parametrize("refined", [0, 1])
def test_the_same_factors_give_gtsam_and_us_the_same_posterior(refined, rng):
    """Means to 1e-6 and standard deviations to 1 %, pose and strain, at every node."""
    problem = problem_of(rng, count=1)
    nodes = peers_gtsam.refine(STATIONS, refined)
    poses = PoseReadings(
        time=np.zeros(len(READ)),
        arclength=problem.reading_arclength,
        values=problem.reading_pose,
        cov=NUMBERS.noise**2,
    )
    exact = SolverOptions(tolerance=1e-7)
    ours = estimate(published(problem), Grid(nodes, [0.0]), [poses], options=exact)
    found = peers_gtsam.optimised(*peers_gtsam.posed(problem, NUMBERS, nodes, 0), tight=True)
    graph, _ = peers_gtsam.posed(problem, NUMBERS, nodes, 0)
    marginals = gtsam.Marginals(graph, found)
    swap = peers_gtsam.SWAP
    for n in range(nodes.size):
        x, e = peers_gtsam.pose_key(n), peers_gtsam.strain_key(n)
        np.testing.assert_allclose(ours.state.pose[0, n], found.atPose3(x).matrix(), atol=1e-6)
        np.testing.assert_allclose(ours.state.strain[0, n], found.atVector(e)[swap], atol=1e-5)
        theirs = [np.diagonal(marginals.marginalCovariance(key))[swap] for key in (x, e)]
        mine = np.diagonal(ours.marginals.cov[0, 18 * n : 18 * n + 12, 18 * n : 18 * n + 12])
        np.testing.assert_allclose(np.sqrt(mine), np.sqrt(np.concatenate(theirs)), rtol=1e-2)


def test_gtsam_on_more_and_more_nodes_comes_to_what_we_say_on_few():
    problem = problem_of(np.random.default_rng(0))
    place, cov = peers.ours(problem, NUMBERS, options=SolverOptions(tolerance=1e-6))
    fine = peers_gtsam.refine(STATIONS, 2)
    limit, spread = peers.ours(problem, NUMBERS, fine, options=SolverOptions(tolerance=1e-6))
    assert np.abs(place - limit).max() < 5e-5
    assert np.abs(std(cov) / std(spread) - 1.0).max() < 5e-3
    far = []
    for refined in range(4):
        theirs, their_cov = peers_gtsam.solve(problem, NUMBERS, refined)
        far.append((np.abs(theirs - limit).max(), np.abs(std(their_cov) / std(spread) - 1.0).max()))
    means, stds = np.array(far).T
    print("largest distance from the limit, 13 to 97 nodes:", means, stds)
    assert np.all(means[1:] < 0.7 * means[:-1])
    assert np.all(stds[1:] < 0.7 * stds[:-1])
    assert stds[-1] < 0.01 < stds[0]


def test_the_published_factors_have_the_slope_they_say():
    rng = np.random.default_rng(1)
    problem = problem_of(rng, count=1)
    prior, grid = published(problem), Grid(STATIONS, [0.0])
    rest = prior.rest_state(grid)
    state = rest.retract(0.3 * rng.standard_normal((1, STATIONS.size, 18)))

    def error(at):
        return next(iter(prior.factors(grid, at, rest, slice(0, 1))))

    batch = error(state)
    jacobian = batch.jacobian.reshape(12, 12, 24)

    def moved(step):
        """Residuals of all intervals when both ends of each move on their own."""
        out = []
        for row, (first, second) in enumerate(batch.nodes):
            change = np.zeros((1, STATIONS.size, 18))
            change[0, first, :12], change[0, second, :12] = step[row, :12], step[row, 12:]
            out.append(error(state.retract(change)).terms.residual[row])
        return np.array(out)

    slope_test(moved, jacobian)
    assert isinstance(state, State)


@pytest.mark.parametrize("curve", peers_curves.CURVES)
def test_a_curve_is_exact_where_it_claims_to_be(curve):
    """All go through exact readings of one arc; those that are arcs are right between them, too."""
    problem = problem_of(np.random.default_rng(2), count=1, noise=0.0)
    bent = problem.base_pose @ se3.exp(STATIONS[:, None] * np.array([0, 0, 1.0, 1.5, -1.0, 0]))
    s, at = STATIONS[[0, *READ]], STATIONS[ASKED]
    solve = peers_curves.CURVES[curve]
    np.testing.assert_allclose(solve(s, bent[[0, *READ]], s[1:]), bent[READ, :3, 3], atol=1e-6)
    between = np.abs(solve(s, bent[[0, *READ]], at) - bent[ASKED, :3, 3]).max()
    assert between < (1e-6 if curve in ("one arc", "constant curvature by pieces") else 5e-3)


def test_the_first_shapes_of_a_problem_are_a_problem():
    problem = problem_of(np.random.default_rng(3), count=3)
    few = problem.first(2)
    place, cov = peers.ours(problem, NUMBERS)
    again, again_cov = peers.ours(few, NUMBERS)
    assert few.query_shape.max() == 1
    np.testing.assert_allclose(again, place[: again.shape[0]], atol=1e-9)
    np.testing.assert_allclose(again_cov, cov[: again.shape[0]], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", REPORTED_ON)
def test_numbers_of_the_page_are_what_the_code_prints(name, spacetime):
    """All but the times, which a page can only date."""
    page = (ROOT / "docs" / "peers.md").read_text(encoding="utf-8")
    for method, told in peers.accuracy(REPORTED_ON[name]()).items():
        assert peers.accuracy_row(method, told) in page
