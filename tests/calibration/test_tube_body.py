"""A motion capture body on the sliding tube judges the slide's encoder, its play and its lag."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import rigs_drawn as rigs
from glissando.calibration.rig.carriage import fit_slide, judgement
from glissando.calibration.rig.rig import PARAMETERS, Noise, Rig, RigData, TubeBody
from glissando.calibration.rig.session_data import rig_data
from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.io.session_log import read_session

LASTS, SEEDS = 45.0, range(20)
NOISE = 1.5e-4 / np.sqrt(3.0)  # m, each component


def _dragged(places, play):
    """What a body does behind play, step by step."""
    out = np.empty(places.size)
    at = places[0]
    for k, place in enumerate(places):
        at = min(max(at, place - 0.5 * play), place + 0.5 * play)
        out[k] = at
    return out


def _session(seed, *, missed=0.0):
    """A slide and a body on its tube, and the true lead, play and delay."""
    rng = np.random.default_rng([seed, 31])
    lead, play = 1.0 + 5e-3 * rng.normal(), abs(1e-4 * rng.normal())
    clock = np.array([rng.uniform(-0.5, 0.5), 1e-4 * rng.normal()])
    path = rigs.path_of("calibrate")
    fine = np.arange(-1.0, LASTS + 1.0, 1e-3)
    behind = lead * _dragged(path.at(fine), play)
    seen = np.arange(0.0, LASTS, 0.01)
    line, start = rng.normal(size=3), se3.exp(rng.normal(size=6))
    poses = np.tile(start, (seen.size, 1, 1))
    poses[:, :3, 3] += np.interp(seen, fine, behind)[:, None] * line / np.linalg.norm(line)
    poses[:, :3, 3] += NOISE * rng.normal(size=(seen.size, 3))
    slide = np.arange(0.0, LASTS, 0.02)
    travel = path.at(slide) + missed * (slide > 0.5 * LASTS)
    data = RigData(
        "coil", np.array([0.0, LASTS]), np.tile(np.eye(4), (2, 1, 1)),
        rigs.stamps(slide, clock, 0.5 * LASTS), travel, {}, 0.7, 5e-3,
        noise=Noise(mocap=np.array([NOISE, 1e-3])), tube=TubeBody("tube", seen, poses),
    )  # fmt: skip
    return data, np.array([lead, play, clock[0]])


@pytest.mark.slow
def test_lead_play_and_delay_are_off_as_far_as_stated():
    nees, off = 0.0, []
    for seed in SEEDS:
        data, true = _session(seed)
        fit = fit_slide(data)
        off.append(np.array([fit.lead, fit.backlash, fit.delay]) - true)
        nees += off[-1] @ np.linalg.solve(fit.cov, off[-1])
        assert fit.along == pytest.approx(NOISE, rel=0.1)
    low, high = chi2.ppf([0.005, 0.995], 3 * len(SEEDS))
    print(f"NEES {nees:.0f}, bounds {low:.0f} to {high:.0f}; off {np.std(off, axis=0)}")
    assert low < nees < high
    assert np.all(np.std(off, axis=0) < [5e-4, 1e-5, 2e-4])


def test_what_agrees_is_no_news_and_what_does_not_is_a_sentence():
    data, true = _session(0)
    fit, cov = fit_slide(data), 1e-10 * np.eye(len(PARAMETERS))
    same = Rig(
        np.eye(4), -1, 0.7, 0.0, lead=true[0], backlash=true[1] + 5e-5,
        slide_clock=np.array([true[2], 0.0]),
    )  # fmt: skip
    assert judgement(fit, same, cov, data) == ()
    late = replace(same, slide_clock=np.array([true[2] + 0.03, 0.0]))
    assert "slide's delay is" in judgement(fit, late, cov, data)[0]
    slips = replace(same, lead=true[0] - 0.02)
    assert "does the tube slip" in judgement(fit, slips, cov, data)[0]
    loose = replace(same, backlash=true[1] - 2e-4)
    assert "mm of play" in judgement(fit, loose, cov, data)[0]
    jumps, _ = _session(0, missed=2e-3)
    assert "the encoder misses steps" in " ".join(judgement(fit_slide(jumps), same, cov, jumps))


def test_a_body_that_was_hardly_seen_is_explained():
    data, _ = _session(0)
    few = replace(data, tube=TubeBody("tube", data.tube.time[:40], data.tube.poses[:40]))
    with pytest.raises(RecordingError, match="slide over the stroke"):
        fit_slide(few)
    assert fit_slide(replace(data, tube=None)) is None


@pytest.mark.slow
def test_a_log_names_the_body_on_the_tube_and_keeps_it_off_the_robot(tmp_path):
    data, _ = rigs.drawn(0)
    tube = _session(0)[0].tube
    bodies = data.bodies | {"tube": rigs.Body(0.0, np.eye(4), tube.time, tube.poses)}
    file = rigs.write(tmp_path / "log.mcap", replace(data, bodies=bodies))
    session = read_session(file)
    setup = session.metadata["setup"].replace(
        '"tube": {"arclength": 0.0,', '"tube": {"slides": true, "arclength": 0.0,'
    )
    read = rig_data(replace(session, metadata=session.metadata | {"setup": setup}))
    assert set(read.bodies) == set(data.bodies)
    assert read.tube.name == "tube"
    assert read.tube.poses.shape[0] > 0.8 * tube.time.size
