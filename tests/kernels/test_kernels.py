"""Every compiled function does what its definition in numpy does, on any shape and any angle."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glissando._kernels import glue as _kernels
from glissando.estimation.interval_system import Layout
from glissando.geometry import se3
from glissando.model.factors import Factors, Residuals
from glissando.model.noise import GemanMcClure
from glissando.model.priors.steps import ARCLENGTH, TIME
from glissando.model.priors.transitions import Bridge
from glissando.model.state import State
from glissando.solver.block_tridiagonal_batch import BatchCholesky
from glissando.twins import TWINS

SHAPES = [(), (1,), (5,), (2, 3), (0,)]
ANGLES = [0.0, 1e-9, 1e-3, 0.5, 1.2, 3.0, np.pi - 1e-9]


def sixes(rng, lead, angle=None):
    x = rng.standard_normal((*lead, 6))
    if angle is not None:
        x[..., 3:] *= angle / np.linalg.norm(x[..., 3:], axis=-1, keepdims=True)
    return x


def spd(rng, lead, n):
    a = rng.standard_normal((*lead, n, n + 3))
    return a @ np.swapaxes(a, -1, -2)


def same(found, expected, tolerance=1e-9):
    """Whether arrays, states, bridges and tuples of them agree in shape and number."""
    if isinstance(expected, tuple):
        assert len(found) == len(expected)
        for mine, its in zip(found, expected, strict=True):
            same(mine, its, tolerance)
    elif isinstance(expected, State | Bridge | BatchCholesky):
        for name, its in vars(expected).items():
            if its is not None:
                same(getattr(found, name), its, tolerance)
    else:
        assert found.shape == expected.shape
        scale = 1.0 + np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * scale)


def states(rng, lead):
    pose = se3.exp(sixes(rng, lead, rng.uniform(0.0, 3.0)))
    return State(pose, sixes(rng, lead), sixes(rng, lead))


def intervals(rng, lead):
    """Rates, steps, densities of the moving field and the carried, variances of jumps."""
    psd, carried = rng.uniform(0.1, 2.0, (2, *lead, 6))
    return sixes(rng, lead), rng.uniform(0.05, 0.4, lead), psd, carried, rng.uniform(0, 1, 6)


def of_se3(name, needs_pose):
    def arguments(rng, lead):
        x = sixes(rng, lead, rng.choice(ANGLES))
        return (se3.exp(x) if needs_pose else x,), {}

    return name, arguments


def slope(rng, lead):
    return (sixes(rng, lead, rng.choice(ANGLES)), sixes(rng, lead)), {}


def noise_of_intervals(rng, lead):
    rate, step, psd, carried, jump = intervals(rng, lead)
    return (rate, step, psd, carried), {"rigid": bool(rng.integers(2)), "jump": jump}


def inside_intervals(rng, lead):
    rate, step, psd, carried, jump = intervals(rng, lead)
    return (rate, step, 0.3 * step, psd, carried, jump), {"rigid": bool(rng.integers(2))}


def covariances(size):
    def arguments(rng, lead):
        cov = spd(rng, lead, size)
        if size == 12:
            cov[..., 6:, 6:] = 30.0 * np.eye(6)
            cov[..., :6, :6] += 40.0 * np.eye(6)
        return (cov,), {}

    return arguments


def weighted(rng, lead):
    """Steps between any two of seven states, as many as `lead` has items."""
    direction, m = (ARCLENGTH, TIME)[rng.integers(2)], int(np.prod(lead))
    nodes, (step, weight) = rng.integers(7, size=(m, 2)), rng.uniform(0.01, 0.3, (2, m))
    densities = tuple(rng.uniform(0.1, 2.0, (3, m, 6)))
    return (direction, states(rng, (7,)), states(rng, (7,)), nodes, step, weight, densities), {}


def still(rng, lead):
    (_, flat, _, nodes, step, _, (psd, _, jump)), _ = weighted(rng, lead)
    return (flat, nodes, step, psd, jump), {}


def pairs(rng, lead):
    direction = (ARCLENGTH, TIME)[rng.integers(2)]
    return (direction, states(rng, lead), states(rng, lead), rng.uniform(0.01, 0.3, lead)), {}


def rated(rng, lead):
    ends = (replace(states(rng, lead), strain_rate=sixes(rng, lead)) for _ in range(2))
    return (*ends, rng.uniform(0.01, 0.3, lead)), {}


def inside_rated(rng, lead):
    (*ends, step), _ = rated(rng, lead)
    gain, rest = rng.standard_normal((*lead, 12, 12)), tuple(rng.standard_normal((2, *lead, 12)))
    return (*ends, step, 0.4 * step, 0.1 * gain, rest), {}


def chains(rng, lead):
    m = int(np.prod(lead))
    lower = rng.standard_normal((m, 3, 12, 12))
    return (spd(rng, (m, 4), 12) + 100.0 * np.eye(12), lower), {}


def explained(rng, lead):
    m = int(np.prod(lead))
    return (rng.standard_normal((m, 4)), 0.05 * rng.standard_normal((m, 4, 20))), {}


def inside_steps(rng, lead):
    direction = (ARCLENGTH, TIME)[rng.integers(2)]
    start, end, step = states(rng, lead), states(rng, lead), rng.uniform(0.01, 0.3, lead)
    about, (psd, carried, jump) = sixes(rng, lead), rng.uniform(0.1, 2.0, (3, *lead, 6))
    return (direction, start, end, step, 0.4 * step, about, (psd, carried, jump)), {}


def sensed(rng, lead):
    at = se3.exp(sixes(rng, lead, rng.choice(ANGLES[:-2])))
    pose, mount = se3.exp(sixes(rng, lead, rng.uniform(0.0, 3.0))), se3.exp(sixes(rng, ()))
    rolls = bool(rng.integers(2))
    values = pose @ mount @ se3.inverse(at)
    if rolls:
        values = values @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, rng.uniform(-3.0, 3.0)]))
    return (values, pose, mount), {"rolls": rolls}


def missed(rng, lead):
    options = {"rolls": bool(rng.integers(2))}
    return (sixes(rng, lead, rng.choice(ANGLES)), se3.exp(sixes(rng, ()))), options


def seen_between(rng, lead):
    m, r = int(np.prod(lead)), int(rng.integers(1, 7))
    by_state = rng.standard_normal((m, r, 18)) * (rng.random(18) < 0.4)
    jacobian, cov = rng.standard_normal((m, 18, 2, 24)), spd(rng, (m,) * int(rng.integers(2)), r)
    return (by_state, jacobian, spd(rng, (m,), 18), cov), {}


ARGUMENTS = dict(
    of_se3(name, name in ("log", "inverse", "adjoint"))
    for name in ("exp", "log", "inverse", "adjoint", "right_jacobian", "right_jacobian_inverse")
) | {
    "right_jacobian_slope": slope,
    "process_covariances": noise_of_intervals,
    "bridge": inside_intervals,
    "sqrt_information": covariances(5),
    "pair_sqrt_information": covariances(12),
    "pose_miss": sensed,
    "pose_slope": missed,
    "by_nodes_of": seen_between,
    "weighted_steps": weighted,
    "squared_innovations": explained,
    "pair_error": pairs,
    "static_steps": still,
    "interval_error": rated,
    "interval_between": inside_rated,
    "factor_batch": chains,
    "bridged": inside_steps,
}


def test_every_twin_is_tested_here():
    assert set(TWINS) == {*ARGUMENTS, "add_factors", "spread_out", "add_to_neighbours"}


@pytest.mark.parametrize("lead", SHAPES, ids=str)
@pytest.mark.parametrize("name", ARGUMENTS)
def test_a_compiled_function_agrees_with_its_definition(name, lead):
    for seed in range(10):
        given_, options = ARGUMENTS[name](np.random.default_rng(seed), lead)
        same(getattr(_kernels, name)(*given_, **options), TWINS[name](*given_, **options))


@given(st.sampled_from([n for n in ARGUMENTS if n in vars(se3)]), st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_motions_agree_at_any_angle(name, seed):
    given_, _ = ARGUMENTS[name](np.random.default_rng(seed), (3,))
    same(getattr(_kernels, name)(*given_), TWINS[name](*given_))


@pytest.mark.parametrize("name", ["sqrt_information", "pair_sqrt_information"])
def test_both_refuse_what_is_no_covariance(name):
    cov = np.broadcast_to(np.eye(12), (2, 12, 12)).copy()
    cov[1, 0, 0] = -1.0
    for function in (TWINS[name], getattr(_kernels, name)):
        with pytest.raises(np.linalg.LinAlgError):
            function(cov)


def batches(rng, layout, count, extras):
    """Factors on one node, on neighbours along the robot, and on four corners of a cell."""
    n = layout.nodes
    for corners in ((0,), (0, 1), (0, 1, n, n + 1))[: 2 + (count > 1)]:
        last = count - (corners[-1] >= n)
        starts = np.array([k * n + i for k in range(last) for i in range(n - (len(corners) > 1))])
        first = np.repeat(starts, 2)
        m, r, dofs = first.size, 3, slice(2, 9)
        jacobian = rng.standard_normal((m, r, len(corners), 7))
        terms = Residuals(
            rng.standard_normal((m, r)),
            np.linalg.cholesky(spd(rng, (m,), r)),
            GemanMcClure(2.0) if len(corners) == 2 else None,
        )
        shifts = rng.standard_normal((m, r, 2 * layout.extras)) if extras else None
        yield Factors(first[:, None] + np.array(corners), dofs, jacobian, terms, shifts)


@pytest.mark.parametrize("extras", [False, True])
@pytest.mark.parametrize("count", [1, 3])
def test_sums_over_intervals_agree(count, extras):
    rng = np.random.default_rng(count)
    layout = Layout(4, 18, 5)
    for batch in batches(rng, layout, count, extras):
        sums = []
        for function in (TWINS["add_factors"], _kernels.add_factors):
            blocks = np.zeros((count, 2 * layout.size, 2 * layout.size))
            pulls = np.zeros((count, 2 * layout.size))
            function(batch, layout, blocks, pulls)
            sums.append((blocks, pulls))
        same(sums[1], sums[0])


@pytest.mark.parametrize("extras", [False, True])
@pytest.mark.parametrize("count", [1, 3])
def test_factors_spread_out_agree(count, extras):
    rng = np.random.default_rng(count)
    layout = Layout(4, 18, 5)
    for batch in batches(rng, layout, count, extras):
        given_ = batch, layout, count
        same(_kernels.spread_out(*given_), TWINS["spread_out"](*given_))


@pytest.mark.parametrize("count", [1, 3])
def test_sums_over_neighbours_agree(count):
    rng = np.random.default_rng(count)
    layout = Layout(4, 18, 0)
    for batch in batches(rng, layout, count, extras=False):
        sums = []
        for function in (TWINS["add_to_neighbours"], _kernels.add_to_neighbours):
            blocks = tuple(np.zeros((count - k, 4, 18, 18)) for k in (0, 0, 1, 1, 1))
            right = np.zeros((4 * count, 18))
            function(batch, layout.nodes, blocks, right)
            sums.append((*blocks, right))
        same(sums[1], sums[0])


USE = """
import os, sys
os.environ['GLISSANDO_COMPILED'] = {wanted!r}
import numpy as np
from glissando import se3, twins
x = np.full(6, 0.1)
before = se3.exp(x)
assert 'numba' not in sys.modules
with twins.estimating():
    assert np.allclose(se3.exp(x), before, rtol=0, atol=1e-15)
assert ('numba' in sys.modules) is {used}
assert np.array_equal(se3.exp(x), before)
"""


@pytest.mark.parametrize(("wanted", "used"), [("0", False), ("1", True)])
def test_compiled_functions_are_used_while_something_is_estimated_if_wanted(wanted, used):
    """In a process of its own, as numba is imported once."""
    code = USE.format(wanted=wanted, used=used)
    subprocess.run([sys.executable, "-c", code], check=True)


def test_simulated_devices_do_not_wait_for_numba():
    code = (
        "import sys\nimport glissando.hardware.simulated_devices\nassert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
