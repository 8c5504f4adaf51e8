"""What a motion's slope tells of a delay, of a window that goes on, is what all readings say."""

import numpy as np
import pytest

from glissando.estimation.slope_information import SlopeInformation, Slopes
from glissando.model.factors import Factors, Residuals
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

N, DOF, SLABS = 2, 3, 9
LAYOUT = Layout(N, DOF, 2)  # of two parameters the first is the delay
SIZE = N * DOF + 1  # numbers of a slab without it
STREAMS = ["early", "late"]


def interval(rng, rows):
    """Factors of an interval between two slabs, of nodes counted from its first."""
    nodes = np.tile(np.arange(2 * N), (rows, 1))
    jacobian = rng.standard_normal((rows, 2, 2 * N, DOF))
    sqrt_info = np.tile(np.diag(rng.uniform(0.5, 2.0, 2)), (rows, 1, 1))
    terms = Residuals(rng.standard_normal((rows, 2)), sqrt_info)
    return Factors(nodes, slice(0, DOF), jacobian, terms, rng.standard_normal((rows, 2, 4)))


def shifted(factors, slabs):
    """The same factors where their interval is so many slabs after the first."""
    nodes = factors.nodes + N * slabs
    return Factors(nodes, factors.dofs, factors.jacobian, factors.terms, factors.extras)


def dense(known, intervals, slopes, kind):
    """sᵀR⁻¹s − bᵀA⁻¹b of all intervals so far, with every number of every slab in one matrix."""
    count = SIZE * (len(intervals) + 1)
    information, b, squares = np.zeros((count, count)), np.zeros(count), 0.0
    information[:SIZE, :SIZE] = known
    for k, (factors, own) in enumerate(zip(intervals, slopes, strict=True)):
        for batch, by_time in [*((each, None) for each in factors), *own]:
            for row in range(len(batch.nodes)):
                jacobian, root = batch.jacobian[row], batch.terms.sqrt_info[row]
                wide, slabs = np.zeros((2, count)), jacobian.reshape(2, 2, N * DOF)
                for late in range(2):
                    begin = SIZE * (k + late)
                    wide[:, begin : begin + N * DOF] = root @ slabs[:, late]
                    wide[:, begin + N * DOF] = root @ batch.extras[row, :, 2 * late + 1]
                information += wide.T @ wide
                if by_time is not None:
                    white = root @ by_time[kind, row]
                    b += wide.T @ white
                    squares += white @ white
    return squares - b @ np.linalg.solve(information, b)


@pytest.mark.parametrize("lag", [1, 2, 4])
def test_it_is_what_a_dense_matrix_of_all_readings_says(lag):
    rng = np.random.default_rng(lag)
    found = SlopeInformation(STREAMS, [0])
    root = rng.standard_normal((LAYOUT.size, LAYOUT.size))
    info = root @ root.T + np.eye(LAYOUT.size)
    found.begin(LAYOUT, info)
    known = np.delete(np.delete(info, N * DOF, 0), N * DOF, 1)
    processes, readings, first = [], [], 0
    for slab in range(1, SLABS):
        processes.append([interval(rng, 6)])
        mine = {name: (interval(rng, 3), rng.standard_normal((2, 3, 2))) for name in STREAMS}
        readings.append(mine)
        sums, slopes = NormalEquationsBuilder.apart(LAYOUT, slab + 1 - first), []
        for k in range(first, slab):
            for batch in processes[k]:
                sums.accumulate(shifted(batch, k - first))
            for name, (batch, by_time) in readings[k].items():
                moved = shifted(batch, k - first)
                sums.accumulate(moved)
                slopes.append(Slopes(name, moved, by_time))
        found.note(sums, slopes)
        while slab + 1 - first > lag:
            found.drop()
            first += 1
            for i, name in enumerate(STREAMS):
                others = [
                    [*own, *(r[0] for n, r in each.items() if n != name)]
                    for own, each in zip(processes[:first], readings[:first], strict=True)
                ]
                of_stream = [[each[name]] for each in readings[:first]]
                for kind in range(2):
                    wanted = dense(known, others, of_stream, kind)
                    assert found.total[i, kind] == pytest.approx(wanted, rel=1e-9)
                assert found.total[i, 2] == 6 * first
    assert first == SLABS - lag


def test_nothing_counts_before_the_motion_tells_more_than_noise_may():
    rng = np.random.default_rng(0)
    found = SlopeInformation(["late"], [0])
    found.begin(LAYOUT, np.eye(LAYOUT.size))
    shares = [found.share("late")]
    for _ in range(40):
        batch, process = interval(rng, 3), interval(rng, 6)
        by_time = rng.standard_normal((2, 3, 2)) * np.array([20.0, 1.0])[:, None, None]
        sums = NormalEquationsBuilder.apart(LAYOUT, 2)
        sums.accumulate(process)
        sums.accumulate(batch)
        found.note(sums, [Slopes("late", batch, by_time)])
        found.drop()
        shares.append(found.share("late"))
    assert shares[0] == shares[1] == 0.0
    assert 0.9 < shares[-1] < 1.0
