"""What simulated sensors say: each imperfection does what it is said to do, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import SimulationError
from glissando.geometry import se3
from glissando.io.shipped_robots import robot_file
from glissando.simulation import Actuation, Imperfections, SlidePath, load_bench, simulate_session
from glissando.simulation.imperfections import PARTS, SmoothField
from glissando.simulation.tracker import coil_rows, mocap_rows

BENCH = load_bench(robot_file("sliding700"))
PURE = BENCH.flaws.without("all")
MOTION = BENCH.move(BENCH.shape("S"), PURE, seed=0)
PATH = SlidePath.oscillate(3, 0.06, BENCH.slide, speed=0.024)
TIME = np.arange(0.0, 16.0, 1 / 40)


def coil(flaws, seed=0, time=TIME, path=PATH):
    return coil_rows(MOTION, path, time, 0.0, BENCH.tracker, flaws, np.random.default_rng(seed))


def in_world(rows):
    return BENCH.tracker @ rows.values


def error(rows):
    """Twists (M, 6) from what is true at the named arclength to what is reported."""
    true = MOTION.at(rows.arclength, rows.time).pose
    return se3.log(se3.inverse(true) @ in_world(rows))


def rms(miss):
    """Root mean square of position and of tilt or rotation in twists (M, 5 or 6)."""
    return [np.sqrt(np.mean(np.sum(part**2, axis=-1))) for part in (miss[:, :3], miss[:, 3:])]


def test_without_imperfections_a_coil_says_what_is():
    rows = coil(PURE)
    assert rows.time.size == TIME.size
    assert np.allclose(rows.arclength, 0.7 - PATH.at(TIME))
    assert np.abs(error(rows)).max() < 1e-9


def test_white_noise_is_as_large_as_said_and_white():
    miss = error(coil(replace(PURE, jitter=1.2e-4, jitter_angle=1e-3, field_size=1e5)))
    assert rms(miss[:, :5]) == pytest.approx([1.2e-4, 1e-3], rel=0.1)
    lag = np.sum(miss[1:] * miss[:-1]) / np.sum(miss**2)
    assert abs(lag) < 0.1


@pytest.mark.slow
def test_bias_is_as_large_as_said_over_many_seeds_and_the_same_when_the_coil_returns():
    flaws = replace(PURE, bias=7.5e-4, bias_angle=7e-3, field_size=1e5)
    miss = np.concatenate([error(coil(flaws, seed)) for seed in range(150)])
    assert rms(miss[:, :5]) == pytest.approx([7.5e-4, 7e-3], rel=0.12)
    period = PATH.duration / 3
    again = error(coil(flaws, 3, np.array([1.0, 1.0 + period, 1.0 + 2 * period])))
    assert np.abs(np.diff(again, axis=0)).max() < 1e-9


def test_bias_hardly_changes_over_a_tenth_of_its_length_and_is_independent_far_away():
    near, far = [], []
    for seed in range(400):
        field = SmoothField.draw(np.random.default_rng(seed), 3, 1, 0.1)
        here, close, away = field(np.array([[0.0, 0, 0], [0.01, 0, 0], [0.5, 0, 0]]))[:, 0]
        near.append(here * close)
        far.append(here * away)
    assert np.mean(near) == pytest.approx(1.0, abs=0.2)
    assert np.mean(far) == pytest.approx(0.0, abs=0.2)


def test_errors_grow_away_from_the_centre_of_the_field():
    flaws = replace(PURE, jitter=1e-4, field_size=0.2)
    far = replace(flaws, field_centre=BENCH.flaws.field_centre + np.array([0.4, 0, 0]))
    near = replace(flaws, field_centre=MOTION.at(0.7, 0.0).pose[:3, 3])
    assert np.std(error(coil(far))[:, :3]) > 3 * np.std(error(coil(near))[:, :3])


@pytest.mark.parametrize("roll", ["arbitrary", "minimal"])
def test_reported_roll_changes_roll_alone(roll):
    rows, true = in_world(coil(replace(PURE, roll=roll))), in_world(coil(PURE))
    assert np.allclose(rows[:, :3, 2:], true[:, :3, 2:], atol=1e-12)
    assert np.abs(rows[:, :3, 0] - true[:, :3, 0]).max() > 0.1


def test_the_minimal_roll_has_no_turn_about_the_trackers_own_z():
    rows = coil(replace(PURE, roll="minimal"))
    assert np.abs(se3.quaternion(rows.values[:, :3, :3])[:, 3]).max() < 1e-12


def test_an_arbitrary_roll_is_one_a_session():
    rows, true = in_world(coil(replace(PURE, roll="arbitrary"))), in_world(coil(PURE))
    turn = se3.log(se3.inverse(true) @ rows)[:, 5]
    assert np.ptp(turn) < 1e-9


def test_drop_outs_last_as_long_as_said_and_are_as_frequent():
    flaws = replace(PURE, dropouts=0.5, dropout_duration=np.array([0.14, 0.34]))
    time = np.arange(0.0, 300.0, 1 / 40)
    kept = coil(flaws, time=time, path=SlidePath.hold(0.0, 300.0, BENCH.slide)).time
    gaps = np.diff(kept)[np.diff(kept) > 0.03]
    assert gaps.min() > 0.14 - 1 / 40
    assert np.median(gaps) < 0.34 + 1 / 40
    assert 90 < gaps.size < 190


def test_registration_moves_all_readings_rigidly():
    rows = coil(replace(PURE, registration=1e-3, registration_angle=5e-3))
    true = in_world(coil(PURE))
    slip = in_world(rows) @ se3.inverse(true)
    assert np.abs(slip - slip[0]).max() < 1e-9
    assert np.abs(slip[0] - np.eye(4)).max() > 1e-4


def test_play_keeps_the_coil_at_its_clearance_from_the_centre():
    rows = coil(replace(PURE, play=3e-4))
    offset = error(rows)[:, :3]
    assert np.allclose(np.linalg.norm(offset[:, :2], axis=1), 3e-4, rtol=0.02)
    assert np.abs(offset[:, 2]).max() < 2e-5


def test_backlash_makes_the_coil_lag_by_half_of_it_whichever_way_it_goes():
    rows = coil(replace(PURE, backlash=4e-4))
    lag = error(rows)[:, 2]
    speed = PATH.speed_at(TIME)
    cruising = np.abs(np.abs(speed) - 0.024) < 1e-9
    cruising &= TIME > 1.0
    assert np.allclose(lag[cruising], 2e-4 * np.sign(speed[cruising]), rtol=1e-3)


def test_encoder_noise_moves_the_named_place_and_not_the_coil():
    rows = coil(replace(PURE, encoder=1e-4))
    inside = PATH.at(TIME) > 1e-3
    assert np.std((rows.arclength - 0.7 + PATH.at(TIME))[inside]) == pytest.approx(1e-4, rel=0.15)
    assert np.allclose(in_world(rows), in_world(coil(PURE)), atol=1e-12)


def test_motion_capture_has_its_own_white_noise():
    flaws = replace(PURE, mocap=1.5e-4, mocap_angle=1.5e-3)
    rows = mocap_rows(MOTION, 0.46, TIME, flaws, np.random.default_rng(0))
    miss = se3.log(se3.inverse(MOTION.at(0.46, 0.0).pose) @ rows.values)
    assert rms(miss) == pytest.approx([1.5e-4, 1.5e-3], rel=0.1)


@pytest.mark.parametrize("part", [p for p in PARTS if p not in ("set", "mocap")])
def test_switching_one_part_off_leaves_the_draws_of_the_others(part):
    """What the part adds to all the others is what it adds alone, to first order."""
    everything, rest = BENCH.flaws, BENCH.flaws.without(part)
    whole, less = coil(everything), coil(rest)
    alone = coil(everything.without(*(p for p in PARTS if p != part)))
    common = sorted(set(whole.time) & set(less.time) & set(alone.time))
    pick = [np.searchsorted(rows.time, common) for rows in (whole, less, alone)]
    axis = [
        in_world(rows)[i][:, :3, 2:] for rows, i in zip((whole, less, alone), pick, strict=True)
    ]
    true = in_world(coil(PURE, time=np.array(common)))[:, :3, 2:]
    change, expected = axis[0] - axis[1], axis[2] - true
    assert np.abs(change - expected).max() < 1e-4 + 0.05 * np.abs(expected).max()


def session(**given):
    return simulate_session(BENCH, MOTION, PATH, **given)


def test_the_same_seed_gives_the_same_session_and_another_one_another():
    first, same, other = (session(seed=seed, duration=2.0) for seed in (5, 5, 6))
    assert np.array_equal(first.coil.values, same.coil.values)
    assert not np.array_equal(first.coil.values, other.coil.values)
    assert set(first.mocap) == {f"mocap_{round(1e3 * s)}" for s in BENCH.truth}


def test_set_bends_the_unloaded_robot_and_another_seed_bends_it_otherwise():
    flaws, straight = BENCH.flaws, BENCH.shape("straight")
    shapes = [
        BENCH.move(straight, flaws, seed).at(np.linspace(0, 0.7, 200), 0.0) for seed in (0, 1)
    ]
    rms = [np.sqrt(np.mean(s.strain[:, 3:5] ** 2)) for s in shapes]
    assert 0.3 * flaws.set_curvature < min(rms) < max(rms) < 2.0 * flaws.set_curvature
    assert np.abs(shapes[0].strain - shapes[1].strain).max() > 0.1
    assert np.abs(BENCH.move(straight, PURE, 0).at(0.7, 0.0).strain[3:]).max() < 1e-9


def test_a_slow_motion_passes_through_the_static_shapes_of_its_tensions():
    slow = BENCH.shape("C-to-S")
    moved = BENCH.move(slow, PURE, 0)
    s = np.linspace(0.0, 0.7, 15)
    for time in (0.0, 3.33, 11.07, 20.0):
        tensions = np.asarray(slow.loads_at(time).tensions)
        still = BENCH.move(Actuation(np.zeros(1), tensions[None], BENCH.gravity), PURE, 0)
        gap = moved.at(s, time).pose[:, :3, 3] - still.at(s, 0.0).pose[:, :3, 3]
        assert np.abs(gap).max() < 1e-6


def test_a_robot_holds_still_before_and_after_a_sudden_pull():
    pull = Actuation(
        np.array([0.0, 5.0, 5.001, 9.0]),
        np.array([[0.0, 0], [0, 0], [12, 0], [12, 0]]),
        BENCH.gravity,
    )
    moved = BENCH.move(pull, PURE, 0)
    for time, like in ((4.7, 0.0), (5.3, 9.0)):
        gap = moved.at(0.7, time).pose[:3, 3] - moved.at(0.7, like).pose[:3, 3]
        assert np.abs(gap).max() < 1e-9


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Imperfections(bias=-1.0), "bias is -1.0; give a number from 0"),
        (lambda: Imperfections(roll="some"), "roll is 'some'; give one of arbitrary"),
        (lambda: Imperfections().without("noise"), "'noise' is not an imperfection; name some of"),
        (lambda: BENCH.shape("Z"), "no shape named 'Z'"),
        (lambda: load_bench(robot_file("tdcr466")), "has no [physics]"),
        (lambda: session(seed=0, duration=-1.0), "session of -1 s cannot be"),
        (lambda: session(seed=-1), "Seed -1 cannot be"),
    ],
)
def test_an_impossible_simulation_is_one_sentence(make, sentence):
    with pytest.raises(SimulationError) as caught:
        make()
    assert sentence in str(caught.value)
