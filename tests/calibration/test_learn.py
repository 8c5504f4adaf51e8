"""Learning robot files: what evidence and truth say of their numbers."""

from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from glissando import GlissandoError, uniform_grid
from glissando.calibration.robot import fisher_information, objective, workers
from glissando.calibration.robot.hyperparameters import expanded, learnable, moved
from glissando.calibration.robot.learn import End, learn
from glissando.calibration.robot.objective import Objective
from glissando.calibration.robot.search import Search
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.sensors import PoseReadings
from glissando.solver.gauss_newton import SolverOptions
from learn_drawn import NOISE, readings, same_process, shipped
from scenes import LENGTH

EXAMPLE = Path(__file__).parents[2] / "examples" / "closed_form_motion.py"


@dataclass(frozen=True)
class Arc:
    """A second of the moving arc, seen by trackers of the robot file's noise; truth if asked."""

    judged: bool = False
    most: float = np.inf  # noise above which the readings cannot be had

    def grid(self, robot):
        return uniform_grid(LENGTH, 3, 0.0, 1.0, 5.0)

    def readings(self, robot):
        std = robot.sensor_std["pose"]
        if std[0] > self.most:
            raise GlissandoError("So much noise cannot be.")
        time = np.linspace(0.0, 1.0, 21)
        places = enumerate((0.0, LENGTH / 2, LENGTH))
        return [readings(PoseReadings, f"p{i}", s, time, cov=std**2, seed=i) for i, s in places]

    def truth(self, robot):
        time = np.linspace(0.0, 1.0, 6)
        exact = readings(PoseReadings, "truth", LENGTH, time, std=np.full(6, 1e-4), seed=9)
        return [exact] if self.judged else []


def start(noise=1.0):
    """A robot as slow as the arc, its trackers said to be so many times as noisy as they are."""
    document = expanded(shipped("tdcr466"))
    document["sensors"]["pose"]["std"] = (noise * NOISE).tolist()
    for key in ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength"):
        document["prior"][key] = [1e-3 * v for v in document["prior"][key]]
    return document


@pytest.fixture
def in_process(monkeypatch):
    monkeypatch.setattr(workers, "ProcessPoolExecutor", same_process)


def by_differences(search, nudge):
    """Slope along each number of minus the objective, of estimates that converged."""

    def value(x):
        document = moved(search.document, search.parameters, x)
        score = search.objective.score(document, search.centre).score
        return search._with_prior(-score.value, x)

    steps = nudge * np.eye(search.x.size)
    return np.array([value(search.x + s) - value(search.x - s) for s in steps]) / (2.0 * nudge)


def of_label(document, word):
    return [p for p in learnable(document, ["pose"]) if word in p.label]


@pytest.mark.slow
def test_evidence_finds_the_noise_of_the_readings(monkeypatch):
    document = start(noise=3.0)
    numbers = of_label(document, "pose noise")
    assert len(numbers) == 2
    found = learn(document, numbers, [Arc()], steps=8)
    std = np.array(found.document["sensors"]["pose"]["std"])
    assert np.all(np.abs(np.log(std / NOISE)) < np.log(1.3))
    assert found.after.value > found.before.value
    assert found.after.samples == 3 * 21 * 6
    assert np.all((found.std > 0.01) & (found.std < 0.3))
    np.testing.assert_allclose(std / (3.0 * NOISE), np.exp(np.repeat(found.moved, 3)))
    monkeypatch.setattr(workers, "ProcessPoolExecutor", same_process)
    alone = learn(document, numbers, [Arc()], steps=8)  # without other processes
    np.testing.assert_array_equal(alone.moved, found.moved)
    np.testing.assert_array_equal(alone.std, found.std)


@pytest.mark.slow
def test_a_start_that_is_a_hundred_times_off_ends_where_one_beside_it_does(in_process):
    found = []
    for noise in (1.5, 100.0):
        document = start(noise=noise)
        learned = learn(document, of_label(document, "pose noise"), [Arc()]).document
        found.append(learned["sensors"]["pose"]["std"])
    np.testing.assert_allclose(np.log(found[1]), np.log(found[0]), atol=0.15)


def test_with_truth_its_prediction_improves_and_every_step_is_reported(in_process):
    document, steps = start(noise=10.0), []
    numbers = of_label(document, "pose noise")
    found = learn(document, numbers, [Arc(judged=True)], steps=3, watch=lambda *a: steps.append(a))
    assert found.after.value > found.before.value + 0.1
    assert found.before.samples == 3 * 6  # of six times 0.2 s apart, those half a second apart
    done, values, expected = np.array(steps).T
    assert np.all(np.diff(done) > 0.0)
    assert np.all(np.diff(values) >= 0.0)
    assert np.all((done <= expected) & (expected <= 3))
    assert [d for d in done if d % 1.0 == 0.0] == list(range(1, found.steps + 1))
    assert len(done) == found.steps * (2 + len(numbers))  # each objective, and the step


def test_a_number_that_readings_do_not_determine_stays_where_it_was(in_process):
    document = start(noise=3.0)
    numbers = [p for p in learnable(document, ["pose", "gyro"]) if "noise" in p.label]
    assert numbers[-1].label == "gyro noise"
    found = learn(document, numbers, [Arc()], steps=6)
    assert abs(found.moved[-1]) < 1e-3
    assert found.std[-1] == pytest.approx(np.log(3.0), rel=1e-3)
    assert np.all(found.std[:-1] < 0.3)
    before, after = (d["sensors"]["gyro"]["std"] for d in (document, found.document))
    assert after == pytest.approx(before, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("judged", [False, True])
def test_slopes_are_those_of_converged_estimates(judged, monkeypatch):
    monkeypatch.setattr(objective, "_TIGHT", SolverOptions(30, 1e-3))

    @dataclass(frozen=True)
    class Late(Arc):
        def grid(self, robot):
            return uniform_grid(LENGTH, 3, -0.3, 1.3, 8.0)  # no delay moves a reading off it

    document = start(noise=3.0)
    drift = {"name": "drift", "kind": "mount", "streams": ["p1"], "correlation_time": 0.5}
    late = {"name": "late", "kind": "time_offset", "streams": ["p1"], "std": [0.05]}
    document["sensor_parameters"] = [{**drift, "std": [1e-3] * 3 + [1e-2] * 3}, late]
    words = ("noise, linear", "spread linear", "correlation", "time, linear", "arclength, bending")
    numbers = [p for word in words for p in of_label(document, word)]
    assert len(numbers) == 5
    goal = Objective([Late(judged=judged)], False)
    middle, zero = goal.score(document, goal.start()), np.zeros(len(numbers))
    around = Search(document, numbers, goal, SimpleNamespace(map=map), 2, middle, zero)
    monkeypatch.setattr(workers, "_objective", goal)
    slope, std = around.differentiate(lambda part: None), around.std
    true_slope = by_differences(around, 0.02)
    assert np.abs(true_slope).max() > 0.3
    np.testing.assert_allclose(slope, true_slope, atol=2e-3 * np.abs(true_slope).max())
    if judged:
        monkeypatch.setattr(
            fisher_information, "NUDGE", 0.02
        )  # above what convergence leaves to go
        around.differentiate(lambda part: None)
        least = 5e-3 * middle.score.independent
        np.testing.assert_allclose(std**-2.0, around.std**-2.0, rtol=0.2, atol=least)


def test_places_that_err_together_count_as_one(in_process):
    @dataclass(frozen=True)
    class Twice(Arc):
        def truth(self, robot):
            (tip,) = super().truth(robot)
            time = tip.time
            return [tip, readings(PoseReadings, "mid", LENGTH / 2, time, std=np.full(6, 1e-4))]

    goals = [Objective([case], False) for case in (Arc(judged=True), Twice(judged=True))]
    once, twice = (goal.score(start(), goal.start()).score for goal in goals)
    assert (once.samples, once.independent) == (18, 18)
    assert (twice.samples, twice.independent) == (36, 18)


def test_the_delay_of_the_first_recordings_truth_is_not_that_of_the_next(in_process):
    @dataclass(frozen=True)
    class Late(Arc):
        def truth(self, robot):
            (tip,) = super().truth(robot)
            early = tip.select(tip.time < 0.9)
            return [replace(early, time=early.time + 0.1)]

    delay = SensorParameter("late", "time_offset", ("truth",), np.array([0.1]), np.zeros(1))

    def score(constants, *cases):
        goal = Objective(cases, False)
        return goal.score(start(), goal.start(constants)).score

    late, timely = Late(judged=True), Arc(judged=True)
    each, both = (score((delay,), late), score((), timely)), score((delay,), late, timely)
    samples = [one.samples for one in each]
    assert both.value == pytest.approx(np.average([one.value for one in each], weights=samples))
    assert both.samples == sum(samples)
    assert both.constants == (delay,)


@pytest.mark.parametrize(
    ("noise", "strain", "word"),
    [(1e6, 1.0, "pose noise"), (1e-6, 1.0, "pose noise"), (1.0, 1e-8, "strain time, bending")],
)
def test_a_start_that_is_far_off_is_no_crash(in_process, noise, strain, word):
    document = start(noise)
    for key in ("psd_strain_arclength", "psd_strain_time"):
        document["prior"][key] = [strain * v for v in document["prior"][key]]
    found = learn(document, of_label(document, word), [Arc()], steps=1)
    assert np.isfinite(found.after.value)
    assert found.after.value >= found.before.value


def test_a_document_that_cannot_be_estimated_is_a_bad_one_and_not_the_end(in_process):
    document = start(noise=0.3)
    case = Arc(most=0.4 * NOISE[0])
    found = learn(document, of_label(document, "pose noise"), [case], steps=2)
    assert found.document["sensors"]["pose"]["std"][0] <= case.most
    assert found.after.value >= found.before.value
    goal = Objective([case], False)
    about = goal.score(document, goal.start())
    assert workers.nearby_score(about, start(noise=1.0)) is None
    assert workers.nearby_score(about, start(noise=0.3)) is not None


def test_a_start_that_cannot_be_estimated_is_said_to_be(in_process):
    document = start()
    with pytest.raises(GlissandoError, match="So much noise cannot be"):
        learn(document, of_label(document, "noise"), [Arc(most=1e-6)], steps=1)


def test_what_was_learned_before_an_interrupt_is_kept(in_process):
    document = start(noise=10.0)
    numbers = of_label(document, "pose noise")

    def interrupted(done, value, expected):
        if done >= 1.0:
            raise KeyboardInterrupt

    found = learn(document, numbers, [Arc()], watch=interrupted)
    assert (found.end, found.steps) == (End.INTERRUPTED, 1)
    assert found.after.value > found.before.value
    assert found.document["sensors"]["pose"]["std"] != document["sensors"]["pose"]["std"]
    with pytest.raises(KeyboardInterrupt):
        learn(document, numbers, [Arc()], watch=lambda *_: interrupted(1.0, 0.0, 1.0))


def test_how_a_search_ended_is_said_and_which_numbers_went_as_far_as_they_may(in_process):
    document = start(noise=1e6)
    numbers = of_label(document, "pose noise")
    first = learn(document, numbers, [Arc()], steps=1)
    assert (first.end, first.at_bounds) == (End.LAST_STEP, ())
    found = learn(document, numbers, [Arc()])
    assert found.end is End.SETTLED
    assert found.at_bounds == tuple(p.label for p in numbers)
    np.testing.assert_allclose(found.moved, -np.log(1e4))


def test_what_was_learned_before_a_process_broke_is_kept(monkeypatch):
    calls = []

    @contextmanager
    def breaking(*given):
        with same_process(*given) as pool:

            def broken(function, *arguments):
                calls.append(function)
                if len(calls) > 2:  # one starts the processes
                    raise BrokenProcessPool
                return map(function, *arguments)

            yield SimpleNamespace(map=broken, shutdown=pool.shutdown)

    monkeypatch.setattr(workers, "ProcessPoolExecutor", breaking)
    document = start(noise=10.0)
    found = learn(document, of_label(document, "pose noise"), [Arc()])
    assert (found.end, found.steps) == (End.BROKEN, 1)
    assert found.after.value > found.before.value
    calls += [None, None]
    with pytest.raises(GlissandoError, match="that there is memory for them"):
        learn(document, of_label(document, "pose noise"), [Arc()])
