import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import generators, law
from glissando.errors import OutsideGridError
from glissando.model.grid import Grid, segment_at, uniform_grid, with_places
from glissando.model.interpolation import sort_points

GRID = Grid([0.0, 0.1, 0.25, 0.4], [1.0, 1.1, 1.25])


def increasing(rng, count):
    return np.cumsum(rng.uniform(0.01, 1.0, count))


@law
@given(generators, st.integers(2, 8))
def test_spans_share_the_whole_length_among_the_nodes(rng, count):
    nodes = increasing(rng, count)
    grid = Grid(nodes, nodes)
    for spans in (grid.arclength_spans, grid.time_spans):
        assert spans.sum() == pytest.approx(nodes[-1] - nodes[0])
        assert np.all(spans > 0.0)


def test_a_lone_node_stands_for_one_whole_unit():
    grid = Grid(0.0, 5.0)
    assert grid.shape == (1, 1)
    np.testing.assert_array_equal([*grid.arclength_spans, *grid.time_spans], [1.0, 1.0])


@law
@given(generators, st.integers(2, 8))
def test_a_point_lies_between_its_node_and_the_next(rng, count):
    nodes = increasing(rng, count)
    grid = Grid(nodes, nodes)
    values = np.append(rng.uniform(nodes[0], nodes[-1], 20), nodes)
    for cells in grid.locate(values, values):
        np.testing.assert_allclose(nodes[cells.lower] + cells.offset, values, rtol=1e-12)
        np.testing.assert_allclose(nodes[cells.lower + 1] - nodes[cells.lower], cells.step)
        assert np.all((cells.offset >= 0.0) & (cells.offset <= cells.step))


@law
@given(generators)
def test_a_point_within_rounding_of_a_node_is_on_it(rng):
    s = np.repeat(GRID.arclength, 3) + 1e-13 * rng.uniform(-1.0, 1.0, 12)
    t = np.tile(GRID.time, 4) + 1e-13 * rng.uniform(-1.0, 1.0, 12)
    (points,) = sort_points(GRID, s, t)
    assert not points.inside_arclength
    assert not points.inside_time


def test_points_are_sorted_by_how_many_nodes_they_touch_and_none_is_lost():
    rng = np.random.default_rng(90)
    s, t = rng.uniform(0.0, 0.4, 50), rng.uniform(1.0, 1.25, 50)
    s[::3], t[::2] = 0.25, 1.1
    found = list(sort_points(GRID, s, t))
    assert [(p.inside_arclength, p.inside_time) for p in found] == [
        (False, False), (False, True), (True, False), (True, True),
    ]  # fmt: skip
    np.testing.assert_array_equal(np.sort(np.concatenate([p.rows for p in found])), np.arange(50))
    for points in found:
        np.testing.assert_array_equal(points.arclength, s[points.rows])
        np.testing.assert_array_equal(points.time, t[points.rows])


@pytest.mark.parametrize(
    ("arclength", "sentence"),
    [
        ([], "Grid arclength must be a list of finite numbers"),
        ([0.0, np.nan], "Grid arclength must be a list of finite numbers"),
        ([[0.0, 1.0]], "Grid arclength must be a list of finite numbers"),
        ([0.0, 0.1 + 0.2, 0.3, 0.4], r"node 1 .* Sort the nodes .* differ by rounding"),
        ([0.0, 0.2, 0.2], r"node 2 \(0.2\) does not exceed node 1 \(0.2\). Sort the nodes"),
    ],
)
def test_a_grid_that_is_none_is_refused(arclength, sentence):
    with pytest.raises(OutsideGridError, match=sentence):
        Grid(arclength, [0.0])


@given(generators)
@law
def test_a_node_that_rounding_parts_from_a_joint_is_the_joint(rng):
    length, count = round(rng.uniform(0.1, 1.0), 2), int(rng.integers(3, 20))
    nodes = np.linspace(0.0, length, count)
    joint = np.array([round(float(nodes[rng.integers(1, count - 1)]), int(rng.integers(2, 5)))])
    placed = with_places(nodes, joint)
    assert joint[0] in placed
    assert np.diff(Grid(placed, [0.0]).arclength).min() > 1e-9
    assert len(placed) == count + (np.abs(nodes - joint).min() > 1e-9)
    assert segment_at(joint, joint * (1.0 - 1e-15)) == 1


def test_rows_off_the_grid_are_counted_and_the_first_three_named():
    s, t = np.array([0.1, 0.5, -0.2, 0.6, 0.45, 0.2]), np.full(6, 1.0)
    with pytest.raises(OutsideGridError) as refusal:
        GRID.require(s, t, "tracker")
    sentence = str(refusal.value)
    assert sentence.startswith("tracker: 4 of 6 rows lie outside the grid; rows 1, 2, 3 have ")
    assert "arclength 0.5, -0.2, 0.6 m, up to 0.2 m outside [0, 0.4] m" in sentence
    with pytest.raises(OutsideGridError, match=r"rows 4, 5 have time 1.3, 0.9 s, up to 0.1 s"):
        GRID.require(np.full(6, 0.1), np.array([1, 1.1, 1.2, 1, 1.3, 0.9]), "tracker")
    with pytest.raises(OutsideGridError, match=r"3 of 3 rows .* row 1 has arclength 0.5 m"):
        GRID.require(np.array([0.1, 0.5, 0.2]), np.array([2.0, 1.0, 3.0]), "tracker")


def test_a_uniform_grid_keeps_both_ends_and_about_the_rate():
    grid = uniform_grid(0.4, nodes=5, start=2.0, stop=3.0, rate=9.7)
    assert grid.shape == (11, 5)
    assert (grid.time[0], grid.time[-1], grid.arclength[-1]) == (2.0, 3.0, 0.4)
    assert uniform_grid(0.4, nodes=2, start=0.0, stop=0.01, rate=1.0).shape == (2, 2)
