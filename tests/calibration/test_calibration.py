"""Calibration: errors are as large as stated, and parameters a session does not show are named."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import rigs_drawn as rigs
from glissando.calibration.rig.calibrate import calibrate
from glissando.calibration.rig.rig import PARAMETERS, Rig, RigData
from glissando.calibration.rig.slide_timing import against_slide
from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.model.slide_track import side_of_play

TAIL = 0.025  # chance that a true law fails, each side
ROBOT = rigs.robot(rigs.NODES)
SHOWN = [k for k, name in enumerate(PARAMETERS) if not name.endswith(("rate", "backlash"))]
ZERO, DELAY, SLIDE_DELAY, LEAD = (
    PARAMETERS.index(name) for name in ("zero", "tracker delay", "slide delay", "lead")
)
UNCERTAIN = "{} is known little better than before"


@pytest.mark.slow
def test_a_session_as_the_page_asks_for_gives_clocks_to_2_ms_and_zero_to_03_mm():
    trial = rigs.trial(rigs.REPORT[0])  # benchmarks/calibration.py takes all
    assert np.all(np.abs(trial.off[[DELAY, SLIDE_DELAY]]) < 2e-3)
    assert abs(trial.off[ZERO]) < 3e-4
    assert np.all(trial.std[[DELAY, SLIDE_DELAY]] < 0.8e-3)
    assert trial.warnings == ()
    low, high = chi2.ppf([TAIL, 1.0 - TAIL], len(PARAMETERS))
    assert low < trial.nees < high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stated", "seeds", "true"), [(1.0, 6, True), (1.3, 4, False), (1.0 / 1.3, 5, False)]
)
def test_errors_are_as_large_as_stated_and_misstated_noise_fails_that(stated, seeds, true):
    nees = 0.0
    for seed in range(seeds):
        made, known, _ = rigs.calibrated(seed, stated=stated)
        off = made.rig.minus(known)[SHOWN]
        nees += off @ np.linalg.solve(made.cov[np.ix_(SHOWN, SHOWN)], off)
    low, high = chi2.ppf([TAIL, 1.0 - TAIL], seeds * len(SHOWN))
    print(f"noise × {stated:.2f}: {nees:.0f}, bounds {low:.0f} to {high:.0f}")
    assert (low < nees < high) == true


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_coil_noisier_than_stated_is_noticed_and_errors_stay_as_large_as_stated(seed):
    data, known = rigs.drawn(seed)
    rng, spread = np.random.default_rng(seed), np.repeat([1e-3, 1e-2, 0.0], [3, 2, 1])
    off = se3.exp(spread * rng.standard_normal((len(data.coil), 6)))
    made = calibrate(replace(data, coil=data.coil @ off), rigs.robot(rigs.NODES), readings=60)
    off = made.rig.minus(rigs.at_epoch(known, made.rig.epoch))[SHOWN]
    nees = off @ np.linalg.solve(made.cov[np.ix_(SHOWN, SHOWN)], off)
    assert nees < chi2.ppf(1.0 - TAIL, len(SHOWN))
    assert 0.5 < made.fits[0].whitened < 1.5


@pytest.mark.slow
def test_readings_that_nothing_explains_are_said_to_be_off():
    made, _, data = rigs.calibrated()
    wave = np.sin(2.0 * data.coil_time)[:, None] * np.array([0.0, 0.0, 0.0, 0.06, 0.0, 0.0])
    found = calibrate(replace(data, coil=data.coil @ se3.exp(wave)), rigs.robot(rigs.NODES))
    assert any("do not trust its deviations" in said for said in found.warnings)
    assert not any("do not trust its deviations" in said for said in made.warnings)


@pytest.mark.slow
def test_the_coil_is_where_the_calibration_says_at_any_time_of_the_session():
    for seed in range(2):
        made, known, data = rigs.calibrated(seed)
        time = np.linspace(1.0, rigs.DURATION - 1.0, 50)
        error = made.rig.arclength(time, data) - known.arclength(time, data)
        assert np.abs(error).max() < 5e-4


@pytest.mark.slow
def test_play_far_beyond_what_was_stated_is_named_and_as_stated_it_is_not(monkeypatch):
    truth, play = rigs.truth, 6e-4
    monkeypatch.setattr(rigs, "truth", lambda *given: replace(truth(*given), backlash=play))
    data, _ = rigs.drawn(0, "posed", sliding="calibrate")
    for stated, named in ((0.1 * play, True), (play, False)):
        noise = replace(data.noise, backlash=stated)
        found = calibrate(replace(data, noise=noise), ROBOT, readings=150)
        said = [w for w in found.warnings if "from what was expected" in w]
        assert any(w.startswith("The backlash was found") for w in said) == named
        assert bool(said) == named


@pytest.mark.slow
def test_a_good_session_warns_of_nothing_but_what_needs_more_time_or_speeds():
    warnings = " ".join(rigs.calibrated()[0].warnings)
    for name in ("zero", "rotation", "position", "lead", "tracker's delay", "direction"):
        assert f"{name} is known little" not in warnings


@pytest.mark.slow
def test_a_still_robot_shows_slide_against_tracker_but_neither_against_motion_capture():
    made, known, _ = rigs.calibrated(0, "bent")
    warnings = " ".join(made.warnings)
    for name in ("The tracker's delay", "The slide's zero"):
        assert UNCERTAIN.format(name) in warnings
    assert "are apart is known to" in warnings
    difference = np.zeros(len(PARAMETERS))
    difference[[DELAY, SLIDE_DELAY]] = -1.0, 1.0
    std = np.sqrt(difference @ made.cov @ difference)
    assert abs(difference @ made.rig.minus(known)) < 4.0 * std < 0.02
    assert made.rig.direction == known.direction


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "uncertain"),
    [
        ("waving", ("lead scale", "slide's delay", "slide's clock rate")),
        ("straight", ("tracker's rotation", "mount's tilt", "mount's offset", "slide's zero")),
    ],
)
def test_a_slide_at_rest_leaves_its_parameters_unknown_and_a_straight_robot_nearly_all(
    shape, uncertain
):
    warnings = " ".join(rigs.calibrated(0, shape, "none")[0].warnings)
    for name in uncertain:
        assert UNCERTAIN.format(name) in warnings
    if shape == "waving":
        assert "The direction is not certain" in warnings
        assert "tracker's delay is known little" not in warnings


@pytest.mark.slow
def test_tracker_readings_that_contradict_all_others_are_left_out_and_counted():
    data, known = rigs.drawn(0)
    data = data.at(np.arange(0, len(data.coil), 10))
    poses = np.array(data.coil)
    poses[[10, 20, 30, 40], :3, 3] += 0.03
    made = calibrate(replace(data, coil=poses), ROBOT)
    assert made.warnings[0].startswith("4 coil readings")
    assert abs(made.rig.minus(rigs.at_epoch(known, made.rig.epoch))[ZERO]) < 5e-4


@pytest.mark.slow
def test_without_a_slide_the_zero_is_where_the_coil_is():
    data, known = rigs.drawn(0, sliding="none", direction=1)
    data = replace(data, slide_time=np.zeros(0), travel=np.zeros(0), coil_arclength=0.66)
    made = calibrate(data, ROBOT, readings=rigs.READINGS)
    place = known.zero + known.lead * 0.03
    assert abs(made.rig.zero - place) < 4.0 * made.std[ZERO] < 4e-3
    assert made.warnings[0].startswith("There is no slide topic")


@pytest.mark.parametrize("direction", [1, -1])
def test_without_motion_capture_the_slide_is_found_against_the_tracker(direction):
    data, known = rigs.drawn(0, "bent", direction=direction)
    made = calibrate(replace(data, bodies={}), ROBOT)
    delay = known.slide_clock[0] - known.tracker_clock[0]
    assert made.rig.direction == direction
    assert made.rig.slide_clock[0] == pytest.approx(delay, abs=0.01)
    assert made.rig.lead == pytest.approx(known.lead, abs=4.0 * made.std[LEAD])
    assert "There is no motion capture" in made.warnings[0]


def against_tracker(seed, play, direction):
    """Errors of lead and slide delay, and their covariance, of a straight robot's coil."""
    rng, stamps = np.random.default_rng([seed, 3]), np.arange(0.0, 30.0, 0.01)
    delay, lead = rng.uniform(-0.2, 0.2), 1.0 + 2e-3 * rng.standard_normal()
    at = stamps % 6.0
    travel = np.interp(at, [0.0, 2.5, 3.0, 5.5, 6.0], [0.0, 0.06, 0.06, 0.0, 0.0])
    followed = travel - 0.5 * play * side_of_play(travel, max(play, 1e-9))
    time = np.arange(0.2, 29.8, 0.025)
    pose = np.tile(np.eye(4), (time.size, 1, 1))
    pose[:, 2, 3] = 0.64 + direction * lead * np.interp(time, stamps, followed)
    pose = pose @ se3.exp(np.repeat([1e-4, 1e-3], 3) * rng.standard_normal((time.size, 6)))
    data = RigData("coil", time, pose, stamps + delay, travel, {}, 0.64, 0.005)
    made = calibrate(data, ROBOT)
    assert made.rig.direction == direction
    own = np.ix_([LEAD, SLIDE_DELAY], [LEAD, SLIDE_DELAY])
    return np.array([made.rig.lead - lead, made.rig.slide_clock[0] - delay]), made.cov[own]


@pytest.mark.parametrize("direction", [1, -1])
def test_play_that_is_expected_is_no_late_clock_without_motion_capture(direction):
    drawn = [against_tracker(k, 1e-4 * abs(np.random.default_rng(k).standard_normal()), direction)
             for k in range(12)]  # fmt: skip
    nees = sum(off @ np.linalg.solve(cov, off) for off, cov in drawn)
    assert nees < chi2.ppf(1.0 - TAIL, 2 * len(drawn))


def test_too_few_coil_readings_are_refused_with_a_sentence():
    data, _ = rigs.drawn(0, "bent")
    with pytest.raises(RecordingError, match="needs 10 readings or more"):
        calibrate(data.at(np.arange(3)), ROBOT)


def noise(**parts):
    return lambda data: {"noise": replace(data.noise, **parts)}


def bodies(**parts):
    return lambda data: {"bodies": {n: replace(b, **parts) for n, b in data.bodies.items()}}


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (lambda data: {"coil_arclength": 700.0}, "Coil 'coil' is stated at the arclength 700 m"),
        (lambda data: {"coil_arclength_std": 5.0}, "deviation of the coil's arclength is 5 m"),
        (lambda data: {"travel": 1e3 * data.travel}, "slide's way is 60 m"),
        (noise(mocap=np.array([0.2, 0.1])), "noise of motion capture is 0.2 m"),
        (noise(coil=np.array([0.1, 0.001])), "noise of the coil is 0.1 m"),
        (noise(bias=np.array([0.4, 5e-3, 0.1])), "bias of the tracker is 0.4 m"),
        (noise(bias=np.array([4e-4, 5e-3, 100.0])), "length of the bias of the tracker is 100 m"),
        (noise(play=np.array([0.3, 75.0])), "play of the coil's tube is 0.3 m"),
        (noise(play=np.array([3e-4, 75.0])), "length of the play of the coil's tube is 75 m"),
        (noise(backlash=0.1), "backlash is 0.1 m"),
        (bodies(arclength=340.0), "Body 'base' is stated at the arclength 340 m"),
        (bodies(arclength=-0.01), "Body 'base' is stated at the arclength -0.01 m"),
        (bodies(mount=se3.pose(np.eye(3), np.array([0, 0, 20.0]))), "mount of body 'base' is 20 m"),
    ],
)
def test_lengths_in_millimetres_are_refused_with_the_value_that_is_wrong(wrong, sentence):
    data, _ = rigs.drawn(0, "bent")
    with pytest.raises(RecordingError, match=sentence) as refused:
        calibrate(replace(data, **wrong(data)), ROBOT)
    assert "give metres" in str(refused.value)


def test_a_body_that_was_seen_once_is_refused_with_a_sentence():
    data, _ = rigs.drawn(0, "bent")
    tip = data.bodies["tip"]
    once = {"tip": replace(tip, time=tip.time[150:151], poses=tip.poses[150:151])}
    with pytest.raises(RecordingError, match="saw tip at a single time"):
        calibrate(replace(data, bodies=once), ROBOT)


def test_a_slide_that_rests_while_the_coil_is_seen_shows_nothing_of_itself():
    data, _ = rigs.drawn(0, "bent")
    rest = np.where(data.slide_time < data.coil_time[0] - 1.0, data.travel, data.travel[-1])
    rest[0] = data.travel[-1] - 0.02
    late = data.at(np.flatnonzero(data.coil_time > data.coil_time[0] + 3.0))
    made = calibrate(replace(late, bodies={}, travel=rest), ROBOT)
    assert made.rig.lead == 1.0
    assert any("lead scale is known little better" in w for w in made.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "sliding"), [("posed", "calibrate"), ("waving", "two speeds"), ("straight", "even")]
)
def test_without_motion_capture_a_moving_robot_makes_nothing_known_too_well(shape, sliding):
    names = [PARAMETERS.index(name) for name in ("lead", "slide delay")]
    worst = 0.0
    for seed in range(500, 506):
        data, known = rigs.drawn(seed, shape, sliding=sliding)
        made = calibrate(replace(data, bodies={}), ROBOT)
        true = rigs.at_epoch(known, made.rig.epoch)
        apart = true.slide_clock[0] - true.tracker_clock[0]
        off = np.array([made.rig.lead - true.lead, made.rig.slide_clock[0] - apart])
        worst = max(worst, float(np.abs(off / made.std[names]).max()))
        assert made.rig.direction == known.direction
    assert worst < 3.0


@pytest.mark.parametrize("kept", ["rests", "two readings"])
def test_a_coil_that_shows_nothing_of_the_slide_leaves_the_rig_as_expected(kept):
    data, _ = rigs.drawn(0, "straight")
    if kept == "rests":
        data = replace(data, coil=np.broadcast_to(data.coil[0], data.coil.shape))
    else:
        near = np.searchsorted(data.coil_time, data.coil_time[0] + 0.12)
        data = data.at(np.array([0, near]))
    found, cov = against_slide(data, Rig(np.eye(4), 1, 0.7, 0.0), np.ones(len(PARAMETERS)))
    assert found.lead == 1.0
    np.testing.assert_array_equal(cov, np.eye(len(PARAMETERS)))


@pytest.mark.parametrize(("noise", "speed"), [(1e-4, 0.004), (3e-4, 0.012)])
def test_noise_of_a_coil_is_no_motion_of_the_robot(noise, speed):
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 60.0, 0.025)
    travel = 0.03 + speed / 0.2 * np.sin(0.2 * (time + 0.15))  # 0.15 s early
    coil = np.tile(np.eye(4), (time.size, 1, 1))
    coil[:, 2, 3] = 0.97 * (0.03 + speed / 0.2 * np.sin(0.2 * time))
    coil[:, :3, 3] += noise * rng.standard_normal((time.size, 3))
    data, _ = rigs.drawn(0, "straight")
    data = replace(data, coil_time=time, coil=coil, slide_time=time, travel=travel, bodies={})
    std = np.ones(len(PARAMETERS))
    found, cov = against_slide(data, Rig(np.eye(4), 1, 0.7, 30.0), std)
    lead, late = (PARAMETERS.index(name) for name in ("lead", "slide delay"))
    assert found.lead == pytest.approx(0.97, abs=3.0 * cov[lead, lead] ** 0.5)
    assert abs(found.slide_clock[0] + 0.15) < 3.0 * cov[late, late] ** 0.5 < 0.3


def test_a_calibration_without_a_solution_ends_in_a_sentence(monkeypatch):
    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    data, _ = rigs.drawn(0, "bent")
    monkeypatch.setattr("glissando.calibration.rig.calibrate.against_slide", singular)
    with pytest.raises(RecordingError, match=r"has no solution \(Singular matrix\)"):
        calibrate(replace(data, bodies={}), ROBOT)
