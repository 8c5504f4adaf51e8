"""A coil that slides in a channel beside the backbone is where the shape says, and says so."""

import numpy as np
import pytest

from glissando import (
    BaseVariance,
    CoilReadings,
    FixedLagSmoother,
    Grid,
    SensorParameter,
    SeparablePrior,
    estimate,
)
from glissando.errors import GlissandoError, SensorError
from glissando.estimation.channels import place_in_channel, placed
from glissando.evaluation.metrics import errors_against
from glissando.geometry import se3
from glissando.io.csv_stream import Rows, Stream
from glissando.io.journal import Journal
from glissando.io.recording_folder import load_recording
from glissando.io.recording_writer import write_streams
from glissando.model.state import State
from glissando.model.tendons.channel import Channel
from glissando.simulation import Loads, Rod, Wrench, solve_shape

LENGTH = 0.4
NODES = np.linspace(0.0, LENGTH, 9)
STD = np.repeat([0.3e-3, 3e-3], [3, 2])
BESIDE = Channel(0.006, 0.4)
ROUND = Channel(0.006, 0.4, 0.2)
ROD = Rod.of_tubes(LENGTH, [(2e-3, 0.0)], young=60e9, poisson=0.33, density=6450.0)
STIFF = np.array([1, 1, 1, 1, 1, 0.003])  # hardly twisted, else the robot may lie on any side
PRIOR = SeparablePrior(
    np.repeat([1e-8, 60.0], 3) * STIFF,
    1.0,
    BaseVariance(np.full(6, 1e-10), np.repeat([1e-8, 40.0], 3) * STIFF),
)
GRID = Grid(NODES, [0.0])


def bent(rng, channel, zero=0.0, force=1.2):
    """A simulated rod's shape, and a coil's readings of it at travels measured in space."""
    side = rng.standard_normal(3) * [force, force, 0.0]
    shape = solve_shape(ROD, [], Loads(wrenches=[Wrench(LENGTH, side)]))
    fine = np.linspace(0.0, LENGTH, 2001)
    at = shape.at(fine).pose
    path = at[:, :3, 3] + np.einsum("mij,mj->mi", at[:, :3, :3], channel.path(fine)[0])
    travel = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    rows = np.linspace(200, 1980, 12).astype(int)
    z = path[rows + 5] - path[rows - 5]
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    y = np.cross(z, rng.standard_normal(z.shape))
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    pose = np.tile(np.eye(4), (rows.size, 1, 1))
    pose[:, :3, :3] = np.stack([np.cross(y, z), y, z], axis=-1)
    pose[:, :3, 3] = path[rows]
    off = np.zeros((rows.size, 6))
    off[:, :5] = STD * rng.standard_normal((rows.size, 5))
    data = {"time": np.zeros(rows.size), "arclength": travel[rows] - zero, "cov": STD**2}
    coil = CoilReadings(**data, values=pose @ se3.exp(off), name="coil", channel=channel)
    return shape, coil, fine[rows]


@pytest.mark.parametrize("channel", [BESIDE, ROUND])
def test_the_coil_is_found_beside_its_place_and_points_along_its_channel(channel):
    rng = np.random.default_rng(1)
    for _ in range(3):
        _, coil, place = bent(rng, channel)
        posterior = estimate(PRIOR, GRID, [coil])
        (found,) = placed([coil], posterior)
        assert np.abs(found.arclength - place).max() < 2e-4
        residual = found.residual(posterior.at(found.arclength, found.time))
        assert np.sqrt(np.mean((residual / STD) ** 2)) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize("channel", [BESIDE, ROUND])
def test_confidence_of_shapes_seen_from_a_channel_is_true(channel):
    """The position errors' mean square is one per degree of freedom."""
    rng, sizes = np.random.default_rng(7), []
    for _ in range(12):
        shape, coil, _ = bent(rng, channel)
        at = estimate(PRIOR, GRID, [coil], gate=None).at(NODES[2:], 0.0)
        off = at.position - shape.at(NODES[2:]).pose[:, :3, 3]
        cov = at.cov_position_world + 1e-12 * np.eye(3)
        sizes.append(np.mean(np.einsum("mi,mij,mj->m", off, np.linalg.inv(cov), off)) / 3.0)
    assert 0.3 < np.mean(sizes) < 1.4


def test_truth_in_a_channel_is_judged_where_an_estimate_places_it():
    _, coil, _ = bent(np.random.default_rng(5), BESIDE)
    posterior = estimate(PRIOR, GRID, [coil])
    with pytest.raises(SensorError, match="coil: truth in a channel is beside the backbone"):
        errors_against(posterior, coil)
    errors = errors_against(posterior, *placed([coil], posterior))
    assert errors.position.max() < 5.0 * STD[0]


def test_a_channel_of_no_radius_is_the_backbone():
    _, coil, _ = bent(np.random.default_rng(2), BESIDE)
    (on_axis,) = placed([coil], estimate(PRIOR, GRID, [coil]))
    near = on_axis.changed(channel=Channel(0.0, 1.0, 0.3), beside=None)
    one, other = (
        estimate(PRIOR, GRID, [r], gate=None).state.pose for r in (near, near.changed(channel=None))
    )
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_in_a_bend_the_place_follows_from_the_travel_in_closed_form():
    curvature, time = 4.0, np.array([0.0, 1.0])
    strain = np.tile([0.0, 0.0, 1.0, 0.0, curvature, 0.0], (2, NODES.size, 1))
    pose = se3.exp(NODES[:, None] * strain)
    state = State(pose, strain, 0.0 * strain, 0.0 * strain)
    travel = np.array([0.1, 0.3])
    coil = CoilReadings(
        time=time,
        arclength=travel,
        values=np.tile(np.eye(4), (2, 1, 1)),
        cov=STD**2,
        channel=BESIDE,
    )
    found = place_in_channel(coil, PRIOR, Grid(NODES, time), state)
    shorter = 1.0 - BESIDE.radius * np.cos(BESIDE.angle) * curvature
    np.testing.assert_allclose(found.arclength, travel / shorter, atol=1e-9)
    np.testing.assert_allclose(found.mount[:, :3, 3], BESIDE.path(np.zeros(2))[0])
    np.testing.assert_allclose(found.mount[:, :3, :3], np.tile(np.eye(3), (2, 1, 1)), atol=1e-12)


def test_the_encoders_zero_is_estimated():
    zero = SensorParameter("zero", "arclength_offset", ("coil",), np.zeros(1), np.array([0.01]))
    _, coil, _ = bent(np.random.default_rng(3), BESIDE, zero=4e-3)
    posterior = estimate(PRIOR, GRID, [coil], sensor_parameters=[zero])
    value, cov = posterior.parameter("zero")
    assert abs(value[0, 0] - 4e-3) < 3.5 * np.sqrt(cov[0, 0, 0])
    assert np.sqrt(cov[0, 0, 0]) < 1.5e-3


@pytest.mark.slow
@pytest.mark.parametrize("channel", [BESIDE, ROUND])
def test_a_window_as_long_as_the_recording_is_the_batch_estimate(channel):
    times = np.array([0.0, 0.1, 0.2])
    coil = bent(np.random.default_rng(11), channel, force=0.3)[1]
    coil = coil.select(np.argsort(np.arange(len(coil)) % 3, kind="stable"))
    coil = coil.changed(time=np.repeat(times, 4))
    batch = estimate(PRIOR, Grid(NODES, times), [coil], gate=None)
    smoother = FixedLagSmoother(PRIOR, NODES, window=times.size, gate=None)
    smoother.add(coil)
    for time in times:
        smoother.advance(float(time))
    smoother.iterate()
    found, std = smoother.posterior(), np.sqrt(np.einsum("kii->ki", batch.marginals.cov))
    off = found.state.difference(batch.state).reshape(std.shape)
    assert np.abs(off / std).max() < 0.1  # by what places may still move in the batch
    its = np.sqrt(np.einsum("kii->ki", found.marginals.cov))
    np.testing.assert_allclose(its, std, rtol=0.02)


def test_a_smoother_drops_a_travel_that_no_bending_explains_and_a_journal_keeps_the_rest(tmp_path):
    _, coil, _ = bent(np.random.default_rng(12), ROUND)
    wrong = coil.arclength + np.where(np.arange(len(coil)) == 11, 0.3, 0.0)
    smoother = FixedLagSmoother(PRIOR, NODES)
    smoother.add(coil.changed(arclength=wrong))
    assert smoother.dropped["coil"]["off the robot"] == 1
    with Journal(tmp_path / "log") as log:
        log.write(coil)
    assert load_recording(tmp_path / "log").streams["coil"].channel == ROUND


def test_a_recording_states_the_channel_and_keeps_it(tmp_path):
    _, coil, _ = bent(np.random.default_rng(4), ROUND)
    rows = Rows("coil", coil.time, coil.arclength, coil.values, {})
    write_streams(tmp_path / "in", "beside", [Stream("coil", rows, channel=ROUND)])
    assert load_recording(tmp_path / "in").streams["coil"].channel == ROUND
    text = (tmp_path / "in" / "recording.toml").read_text()
    millimetres = text.replace("radius = 0.006", "radius = 6")
    (tmp_path / "in" / "recording.toml").write_text(millimetres)
    with pytest.raises(GlissandoError, match="cannot be; give metres"):
        load_recording(tmp_path / "in")


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"angle": 10.0}, "10 degrees are 0.1745 rad"), ({"pitch": 1e-3}, "give the pitch in metres")],
)
def test_a_channel_in_other_units_is_one_sentence(wrong, words):
    with pytest.raises(SensorError, match=words):
        Channel(**({"radius": 0.004} | wrong))


def test_a_travel_beyond_the_channel_is_one_sentence():
    _, coil, _ = bent(np.random.default_rng(5), BESIDE)
    with pytest.raises(SensorError, match="correct its zero"):
        estimate(PRIOR, GRID, [coil.changed(arclength=coil.arclength + 0.2)])


def test_where_a_reading_was_taken_moves_with_the_strain_as_its_slope_says():
    rng, time = np.random.default_rng(6), np.zeros(1)
    coil = CoilReadings(
        time=time, arclength=time + 0.27, values=np.eye(4)[None], cov=STD**2, channel=ROUND
    )

    def placed_in(change):
        strain = np.tile(np.array([0.0, 0.0, 1.0, 2.0, -3.0, 0.5]) + change, (1, NODES.size, 1))
        state = State(se3.exp(NODES[:, None] * strain), strain, 0.0 * strain, 0.0 * strain)
        return place_in_channel(coil, PRIOR, Grid(NODES, time), state)

    slope = placed_in(0.0).beside[0, 0].sum(axis=0)
    for _ in range(5):
        step = 1e-3 * rng.standard_normal(6) * np.repeat([0.1, 1.0], 3)
        ends = [placed_in(sign * step).arclength[0] for sign in (1.0, -1.0)]
        assert slope @ step == pytest.approx(0.5 * (ends[0] - ends[1]), rel=5e-3, abs=1e-9)
