"""The parts of a calibration against their definitions."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import block_diag

import rigs_drawn as rigs
from glissando.calibration.rig.calibrate import _fit_direction, _usable
from glissando.calibration.rig.initial_guess import registration
from glissando.calibration.rig.model import CoilModel
from glissando.calibration.rig.rig import PARAMETERS, Body, Rig, RigData
from glissando.calibration.rig.shape import _moves, _nodes, estimate_shape, shape_covariance
from glissando.calibration.rig.slide_timing import LATEST, slide_lag
from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.io.robot_file import load_robot
from glissando.io.robot_template import RobotOutline, robot_text
from glissando.model.interpolation import sort_points
from glissando.model.slide_track import side_of_play
from glissando.model.tendons.channel import Channel
from glissando.solver.block_tridiagonal import factor
from oracles import dense

ROBOT = rigs.robot(rigs.NODES)


@cache
def small_model():
    data, known = rigs.drawn(0)
    shape = estimate_shape(data, ROBOT)
    return CoilModel(data.thinned(12), shape, factor(shape.system)), known


@pytest.mark.slow
def test_slopes_of_the_coil_by_the_rig_are_right():
    model, known = small_model()
    said = se3.inverse(known.T_wt) @ model.states(*model.points(known)).pose @ known.coil_mount
    ideal = replace(model, data=replace(model.data, coil=said))
    jacobian = ideal.jacobian(known)
    for k, nudge in enumerate(1e-5 * np.eye(len(PARAMETERS))):
        slope = (ideal.residual(known.moved(nudge)) - ideal.residual(known.moved(-nudge))) / 2e-5
        assert np.abs(slope).max() > 1e-3
        assert np.allclose(slope, jacobian[:, k], atol=1e-4 * np.abs(slope).max())


@pytest.mark.slow
@pytest.mark.parametrize("channel", [None, Channel(0.004, 0.5)])
def test_a_coil_on_its_stated_mount_is_where_the_model_expects_it_whatever_its_roll(channel):
    model, known = small_model()
    known = replace(known, mount=np.zeros(4))
    stated = se3.exp(np.array([0.005, 0.002, 0.0, 0.05, -0.03, 0.0]))
    plain = replace(model.data, channel=channel)
    model = replace(model, data=replace(plain, mount=stated))
    arclength, time = model.points(known)
    roll = np.zeros((time.size, 6))
    roll[:, 5] = np.linspace(-3.0, 3.0, time.size)
    mount_at = known.mount_at(arclength, plain) @ stated
    said = se3.inverse(known.T_wt) @ model.states(arclength, time).pose @ mount_at @ se3.exp(roll)
    ideal = replace(model, data=replace(model.data, coil=said))
    np.testing.assert_allclose(ideal.residual(known), 0.0, atol=1e-9)


@pytest.mark.slow
def test_a_coil_beyond_the_robots_end_is_told_from_one_at_it():
    """Else a zero near the tip would be known where it cannot be."""
    model, known = small_model()
    beyond = known.zero - model.points(known)[0].max() + model.shape.grid.arclength[-1]
    ends = [replace(known, zero=beyond + far) for far in (0.004, 0.002, 0.0)]
    there, nearer, at = (model.states(*model.points(rig)).pose[:, :3, 3] for rig in ends)
    outside = model.points(ends[1])[0] > model.shape.grid.arclength[-1]
    assert outside.any()
    np.testing.assert_allclose(np.linalg.norm(there - nearer, axis=1), 0.002, rtol=0.02)
    np.testing.assert_allclose(np.linalg.norm(nearer - at, axis=1), 0.002, rtol=0.02)
    assert np.linalg.eigvalsh(model.covariance(ends[0])).min() > 0.0


@pytest.mark.slow
def test_a_lead_that_has_turned_over_is_the_other_directions():
    model, known = small_model()
    std = np.full(len(PARAMETERS), 0.02)
    away = -known.direction
    starts = {known.direction: known, away: replace(known, direction=away, lead=-known.lead)}
    for direction in starts:
        found = _fit_direction(model, starts, direction, std)
        assert found.rig.direction == known.direction
        assert found.rig.lead == pytest.approx(known.lead, rel=0.02)
    assert _fit_direction(model, {away: starts[away]}, away, std).rig.direction == away


@pytest.mark.slow
def test_bodies_are_seen_to_move_and_to_hold():
    data, _ = rigs.drawn(0, "posed", sliding="calibrate")
    time = np.arange(0.0, 40.0, 0.05) + 0.025
    held = time % 5.0 < 3.0
    moves = _moves(data, time)
    assert moves[~held & (time % 5.0 > 3.3) & (time % 5.0 < 4.7)].mean() > 0.95
    assert moves[held & (time % 5.0 > 0.5) & (time % 5.0 < 2.5)].mean() < 0.02


@pytest.mark.slow
def test_the_covariance_of_a_bunch_is_that_of_the_mean_of_its_readings():
    model, known = small_model()
    data, _ = rigs.drawn(0)
    assert data.block_size == 5
    model = replace(model, data=data.at(np.arange(100, 500)).blocks(5, 10), block_size=5)
    each = replace(model, block_size=1).covariance(known)
    assert np.allclose(
        model.residual(known),
        replace(model, block_size=1).residual(known).reshape(-1, 5, 5).mean(axis=1).ravel(),
    )
    mean = np.kron(np.kron(np.eye(10), np.full((1, 5), 0.2)), np.eye(5))
    there, said = mean @ each @ mean.T, model.covariance(known)
    scale = np.sqrt(said.diagonal())
    assert np.abs((said - there) / np.outer(scale, scale)).max() < 0.3


def test_bunches_are_of_readings_that_follow_each_other_closely():
    data, _ = rigs.drawn(0)
    gone = np.delete(np.arange(400), np.arange(100, 140))  # a second
    some = data.at(gone).blocks(5, 1000)
    lasts = some.coil_time.reshape(-1, 5)[:, -1] - some.coil_time.reshape(-1, 5)[:, 0]
    assert np.all(lasts < 0.15)
    assert some.coil_time.size >= 350
    assert data.blocks(5, 7).coil_time.size == 35
    assert data.at(np.arange(0, 400, 5)).block_size == 1


@pytest.mark.slow
def test_joint_errors_of_the_shape_are_those_of_the_dense_inverse():
    data, _ = rigs.drawn(0)
    short = {n: replace(b, time=b.time[:30], poses=b.poses[:30]) for n, b in data.bodies.items()}
    shape = estimate_shape(replace(data, bodies=short, travel=np.zeros(2)), ROBOT)
    rng = np.random.default_rng(0)
    time = np.sort(rng.uniform(*shape.grid.time[[0, -1]], 7))
    place = rng.uniform(0.0, 0.7, 7)
    by_state = rng.standard_normal((7, 5, 18))
    joint = shape_covariance(shape, factor(shape.system), place, time, by_state)
    exact = shape.at(place, time).cov
    for i in range(7):
        block = joint[5 * i : 5 * i + 5, 5 * i : 5 * i + 5]
        assert np.allclose(block, by_state[i] @ exact[i] @ by_state[i].T, rtol=1e-6)
    assert np.linalg.eigvalsh(joint)[0] > 0.0
    assert np.allclose(_dense(shape, place, time, by_state), joint, rtol=1e-5, atol=1e-9)


def _dense(shape: Posterior, place, time, by_state):
    """The slow oracle: the whole information matrix, inverted."""
    system = shape.system
    whole = dense.matrix_of(system)
    scale = 1.0 / np.sqrt(whole.diagonal())
    cov = scale[:, None] * np.linalg.inv(scale[:, None] * whole * scale) * scale
    rows, own = [], []
    for i in range(len(time)):
        (points,) = sort_points(shape.grid, place[i : i + 1], time[i : i + 1])
        at = shape.prior.interpolate(shape.grid, shape.state, shape.state, points)
        row = np.zeros((18, len(whole)))
        for c, node in enumerate(at.nodes[0]):
            row[:, node * at.dof : (node + 1) * at.dof] += at.jacobian[0, :, c]
        rows.append(by_state[i] @ row)
        own.append(by_state[i] @ at.cov[0] @ by_state[i].T)
    stacked = np.vstack(rows)
    return stacked @ cov @ stacked.T + block_diag(*own)


@pytest.mark.parametrize(("length", "segments"), [(0.25, 3), (0.1865, 2), (0.7, 1)])
def test_shapes_have_nodes_at_joints_and_ends_off_whole_millimetres(tmp_path, length, segments):
    outline = RobotOutline("r", length, segments, 0.01, 1.5, ["coil"])
    (tmp_path / "r.toml").write_text(robot_text(outline))
    robot, pose = load_robot(tmp_path / "r.toml"), np.eye(4)[None]
    places = length * np.array([0.0, 0.3, 0.7, 1.0])
    bodies = {f"b{s}": Body(s, np.eye(4), np.zeros(1), pose) for s in places}
    none = np.zeros(0)
    nodes = _nodes(RigData("coil", none, pose[:0], none, none, bodies, length, 1e-3), robot)
    assert nodes[0] == 0.0
    assert nodes[-1] == length
    assert np.all(np.diff(nodes) > 5e-4)
    assert set(robot.prior.joints) <= set(nodes)


def test_readings_of_a_tracker_that_freezes_are_left_out_and_counted():
    time, pose = np.linspace(0.0, 10.0, 400), np.tile(np.eye(4), (400, 1, 1))
    pose[:, 0, 3] = 1e-2 * np.sin(time)
    tip = Body(0.7, np.eye(4), time, pose)
    none = np.zeros(0)
    data = RigData("coil", time, pose.copy(), none, none, {"tip": tip}, 0.7, 5e-3)
    assert _usable(data)[0].coil_time.size == time.size
    data.coil[200:] = data.coil[200]
    usable, notes = _usable(data)
    np.testing.assert_array_equal(usable.coil_time, time[:201])
    assert any(note.startswith("199 readings of 'coil'") for note in notes)
    data.coil[:] = data.coil[0]
    assert _usable(data)[0].coil_time.size == time.size


def test_registration_undoes_any_motion_whatever_the_roll():
    rng = np.random.default_rng(1)
    for _ in range(20):
        there = se3.exp(rng.standard_normal((8, 6)))
        T_wt = se3.exp(2.0 * rng.standard_normal(6))
        roll = np.zeros((8, 6))
        roll[:, 5] = rng.uniform(-np.pi, np.pi, 8)
        frame = registration(there, se3.inverse(T_wt) @ there @ se3.exp(roll))
        assert np.allclose(frame, T_wt, atol=1e-9)


def test_the_slides_lag_is_found_by_speeds_alone():
    for seed in range(3):
        data, known = rigs.drawn(seed, "bent")
        late = known.slide_clock[0] - known.tracker_clock[0]
        assert slide_lag(data) == pytest.approx(late, abs=0.05)
        assert abs(slide_lag(data)) <= LATEST


@pytest.mark.parametrize("delay", [0.0, 0.3, -0.4])
@pytest.mark.parametrize("period", [2.0, 4.0])
def test_of_delays_that_an_even_slide_makes_alike_the_nearest_is_taken(period, delay):
    time, slide_time = np.arange(0.0, 10.0, 1 / 40), np.arange(-3.0, 13.0, 0.01)
    rng = np.random.default_rng(3)
    for _ in range(5):
        phase = rng.uniform(0.0, 2.0 * np.pi)
        travel = 0.02 * np.cos(2.0 * np.pi * slide_time / period + phase)
        poses = np.tile(np.eye(4), (time.size, 1, 1))
        poses[:, 2, 3] = -np.interp(time, slide_time, travel)
        poses[:, :3, 3] += 4e-4 * rng.standard_normal((time.size, 3))
        data = RigData("coil", time, poses, slide_time + delay, travel, {}, 0.7, 5e-3)
        assert slide_lag(data) == pytest.approx(delay, abs=0.06)


def test_play_is_taken_up_before_the_coil_follows():
    travel = np.array([0.0, 2e-5, 1e-3, 9.8e-4, 0.0])
    expected = np.array([0.0, 0.4, 1.0, 0.6, -1.0])
    assert np.allclose(side_of_play(travel, 1e-4), expected)


def test_a_clocks_delay_and_rate_are_those_of_the_definition():
    rig = Rig(np.eye(4), 1, 0.0, 5.0, tracker_clock=np.array([0.2, 1e-3]))
    rig = replace(rig, slide_clock=rig.tracker_clock)
    time = np.linspace(0.0, 10.0, 5)
    stamps = rig.slide_stamps(time)
    assert np.allclose(rig.true_time(stamps), time)
    assert np.allclose(stamps, rigs.stamps(time, rig.slide_clock, rig.epoch))
