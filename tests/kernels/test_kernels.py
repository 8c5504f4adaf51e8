"""Every compiled function does what its definition in numpy does, on any shape and any angle."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import oracles.dense
import oracles.factors
import oracles.intervals
import oracles.se3
import oracles.steps
import oracles.transitions
from glissando._kernels import normal_equations
from glissando._kernels.arrays import whole
from glissando.geometry import se3
from glissando.model import noise
from glissando.model.factors import Factors, Residuals
from glissando.model.noise import GemanMcClure
from glissando.model.priors import intervals as intervals_
from glissando.model.priors import steps, transitions
from glissando.model.priors.steps import ARCLENGTH, TIME
from glissando.model.state import State
from glissando.solver.block_tridiagonal import factor
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder, kernel_arguments

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
    elif isinstance(expected, State):
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


def of_se3(needs_pose):
    def arguments(rng, lead):
        x = sixes(rng, lead, rng.choice(ANGLES))
        return (se3.exp(x) if needs_pose else x,), {}

    return arguments


def slope(rng, lead):
    return (sixes(rng, lead, rng.choice(ANGLES)), sixes(rng, lead)), {}


def noise_of_intervals(rng, lead):
    rate, step, psd, carried, jump = intervals(rng, lead)
    return (rate, step, psd, carried), {"rigid": bool(rng.integers(2)), "jump": jump}


def inside_intervals(rng, lead):
    rate, step, psd, _, jump = intervals(rng, lead)
    return (rate, step, 0.3 * step, psd, jump), {}


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
    densities = rng.uniform(0.1, 2.0, (3, m, 6))
    if rng.integers(2):
        densities[..., ::3] = densities[..., 1::3]  # alike across z
    densities = tuple(densities)
    return (direction, states(rng, (7,)), states(rng, (7,)), nodes, step, weight, densities), {}


def still(rng, lead):
    (_, flat, _, nodes, step, _, (psd, _, jump)), _ = weighted(rng, lead)
    return (flat, nodes, step, psd, jump), {}


def rated(rng, lead):
    ends = (replace(states(rng, lead), strain_rate=sixes(rng, lead)) for _ in range(2))
    return (*ends, rng.uniform(0.01, 0.3, lead)), {}


def inside_rated(rng, lead):
    (*ends, step), _ = rated(rng, lead)
    gain, rest = rng.standard_normal((*lead, 12, 12)), tuple(rng.standard_normal((2, *lead, 12)))
    return (*ends, step, 0.4 * step, 0.1 * gain, rest), {}


def seen_between(rng, lead):
    m, r = int(np.prod(lead)), int(rng.integers(1, 7))
    by_state = rng.standard_normal((m, r, 18)) * (rng.random(18) < 0.4)
    jacobian, cov = rng.standard_normal((m, 18, 2, 24)), spd(rng, (m,), r)
    return (by_state, jacobian, spd(rng, (m,), 18), cov), {}


ARGUMENTS = {
    se3.exp: of_se3(False),
    se3.log: of_se3(True),
    se3.so3_log: lambda rng, lead: ((of_se3(True)(rng, lead)[0][0][..., :3, :3],), {}),
    se3.right_jacobian: of_se3(False),
    se3.right_jacobian_inverse: of_se3(False),
    se3.right_jacobian_slope: slope,
    transitions.process_covariances: noise_of_intervals,
    transitions.bridge: inside_intervals,
    noise.sqrt_information: covariances(5),
    steps.weighted_steps: weighted,
    steps.static_steps: still,
    intervals_.interval_error: rated,
    intervals_.interval_between: inside_rated,
}
"""What calls a kernel, and how to draw arguments for it and its definition of the same name."""

KERNELS = {
    normal_equations.at_nodes: seen_between,
}
"""Kernels that are called as they are, on lists."""


def definition(function):
    """The plain definition in numpy of a function of that name."""
    for oracle in (oracles.se3, oracles.transitions, oracles.steps, oracles.intervals,
                   oracles.factors):  # fmt: skip
        if hasattr(oracle, function.__name__):
            return getattr(oracle, function.__name__)
    raise LookupError(function.__name__)


@pytest.mark.parametrize("lead", SHAPES, ids=str)
@pytest.mark.parametrize("function", ARGUMENTS, ids=lambda f: f.__name__)
def test_a_compiled_function_agrees_with_its_definition(function, lead):
    for seed in range(10):
        arguments, options = ARGUMENTS[function](np.random.default_rng(seed), lead)
        same(function(*arguments, **options), definition(function)(*arguments, **options))


@pytest.mark.parametrize("count", [0, 1, 6])
@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: k.__name__)
def test_a_kernel_agrees_with_its_definition(kernel, count):
    for seed in range(10):
        arguments, options = KERNELS[kernel](np.random.default_rng(seed), (count,))
        lists = [
            whole(np.broadcast_to(a, (count, 4, 4)) if a.shape == (4, 4) else a) for a in arguments
        ]
        expected = definition(kernel)(*arguments, **options)
        same(kernel(*lists, *options.values()), expected)


@given(
    st.sampled_from([f for f in ARGUMENTS if f.__module__ == se3.__name__]),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=150, deadline=None)
def test_motions_agree_at_any_angle(function, seed):
    arguments, _ = ARGUMENTS[function](np.random.default_rng(seed), (3,))
    same(function(*arguments), definition(function)(*arguments))


@pytest.mark.parametrize("size", [1, 6, 7, 48, 49, 80])
def test_residuals_of_any_number_of_rows_are_whitened(size):
    rng = np.random.default_rng(size)
    cov = spd(rng, (3,), size)
    same(noise.sqrt_information(cov), oracles.factors.sqrt_information(cov))


def test_both_refuse_what_is_no_covariance():
    cov = np.broadcast_to(np.eye(12), (2, 12, 12)).copy()
    cov[1, 0, 0] = -1.0
    for function in (noise.sqrt_information, oracles.factors.sqrt_information):
        with pytest.raises(np.linalg.LinAlgError):
            function(cov)


def batches(rng, layout, count):
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
        e = layout.parameters
        shifts = rng.standard_normal((m, r, 2 * e)) if e else None
        yield Factors(first[:, None] + np.array(corners), dofs, jacobian, terms, shifts)


def dense(batch, layout, count, *, robust=True):
    """Whitened residual (M r,) and Jacobian (M r, (count + 1) D) by all slabs, one past the end."""
    residual, jacobian = batch.whitened()
    if robust:
        scale = np.sqrt(batch.terms.robust_weights())
        residual, jacobian = residual * scale[:, None], jacobian * scale[:, None, None]
    (m, r), size = residual.shape, layout.size
    out = np.zeros((m, r, (count + 1) * size))
    d = batch.dofs.stop - batch.dofs.start
    for i, nodes in enumerate(batch.nodes):
        for a, node in enumerate(nodes):
            slab, inner = divmod(int(node), layout.nodes)
            at = slab * size + inner * layout.dof + batch.dofs.start
            out[i, :, at : at + d] += jacobian[i, :, a * d : a * d + d]
        e, wide = layout.parameters, len(nodes) * d
        k = min(int(nodes[0]) // layout.nodes, max(count - 2, 0))
        for later in range(2):
            at = (k + later) * size + layout.nodes * layout.dof
            out[i, :, at : at + e] += jacobian[i, :, wide + later * e : wide + later * e + e]
    return residual.reshape(-1), out.reshape(m * r, -1)[:, : count * size]


@pytest.mark.parametrize("by_interval", [False, True])
@pytest.mark.parametrize("parameters", [0, 5])
@pytest.mark.parametrize("count", [1, 3])
def test_sums_are_those_of_the_dense_jacobian(count, parameters, by_interval):
    rng = np.random.default_rng(count)
    layout = Layout(4, 18, parameters)
    builder = NormalEquationsBuilder.joined(layout, count)
    if by_interval:
        shape = count, layout.size
        blocks = (np.empty((k, layout.size, layout.size)) for k in (count, count, count - 1))
        builder = NormalEquationsBuilder(layout, *blocks, np.empty(shape), np.empty(shape))
    matrix, rhs = np.zeros((2, count * layout.size, count * layout.size)), 0.0
    matrix = matrix[0]
    for batch in batches(rng, layout, count):
        builder.accumulate(batch)
        residual, jacobian = dense(batch, layout, count)
        matrix, rhs = matrix + jacobian.T @ jacobian, rhs - jacobian.T @ residual
    diagonal, found = builder.begin.copy(), builder.rhs_begin.copy()
    if by_interval:
        diagonal[1:] += builder.end[:-1]
        found[1:] += builder.rhs_end[:-1]
    d = layout.size
    for k in range(count):
        same(diagonal[k], matrix[k * d : k * d + d, k * d : k * d + d])
        if k + 1 < count:
            same(builder.across[k], matrix[k * d + d : k * d + 2 * d, k * d : k * d + d])
    same(found.ravel(), rhs)


@pytest.mark.parametrize("parameters", [0, 5])
@pytest.mark.parametrize("count", [1, 3])
def test_innovations_are_those_of_the_dense_system(count, parameters):
    rng = np.random.default_rng(count)
    layout = Layout(4, 18, parameters)
    found, builder = list(batches(rng, layout, count)), NormalEquationsBuilder.joined(layout, count)
    for batch in found:
        builder.accumulate(batch)
    system = builder.system().add_to_diagonal(np.full((count, layout.size), 0.3))
    cholesky = factor(system)
    step = cholesky.solve(builder.rhs_begin)
    cov = np.linalg.inv(oracles.dense.matrix_of(system))
    for batch in found:
        which = np.flatnonzero(rng.random(len(batch.nodes)) < 0.6)
        residual, jacobian = dense(batch, layout, count, robust=False)
        rows = residual.reshape(-1, 3), jacobian.reshape(-1, 3, count * layout.size)
        weight = batch.terms.robust_weights()
        expected = oracles.factors.squared_innovations(*rows, cov, step.ravel(), weight)[which]
        same(
            normal_equations.squared_innovations(
                *kernel_arguments(batch), which, layout.nodes, layout.dof,
                cholesky.inverse, cholesky.coupling, np.arange(count), step, weight[which],
            ),
            expected,
            1e-6,
        )  # fmt: skip
