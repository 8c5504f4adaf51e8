"""What is given from Python in another form, unit or order is one sentence, as in files."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import (
    BaseVariance,
    CoilReadings,
    FixedLagSmoother,
    GlissandoError,
    Grid,
    Posterior,
    Robot,
    SensorParameter,
    SeparablePrior,
    check,
    errors_against,
    estimate,
    load_posterior,
    load_robot,
    plan_slide,
    save_posterior,
    save_view,
    simulate,
)
from glissando.errors import EstimateWarning, PlanWarning
from glissando.io.recording import Recording
from glissando.model.slide_path import SlideLimits, SlidePath
from glissando.planning import Chance, LogDet, Trace, Worst, Zone, predict_information
from glissando.planning.compare import evaluate_path
from glissando.planning.path_objective import path_objective_of
from glissando.planning.path_space import path_space_of
from glissando.planning.replan import Replanner
from glissando.planning.zones import MovingInterval

ROBOT = load_robot("tdcr466")
SLIDING = load_robot("sliding700")
LIMITS = SlideLimits(0.06, 0.024, 0.1)


def coil(name="coil", **more):
    tip = np.tile(np.eye(4), (5, 1, 1))
    tip[:, 2, 3] = ROBOT.length
    given = {"time": np.linspace(0.0, 1.0, 5), "arclength": np.full(5, ROBOT.length)}
    return CoilReadings(**{**given, "values": tip, "cov": np.r_[1e-6 * np.ones(3), 1e-4, 1e-4],
                           "name": name, **more})  # fmt: skip


def refused(call, said):
    with pytest.raises(GlissandoError, match=said):
        call()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"length": 466.0}, "466 m; give metres"),
        ({"length": np.nan}, "length holds nan"),
        ({"name": 0.466}, "name is 0.466; give a text, and then the length"),
        ({"arclength_nodes": [0.0, 0.2]}, "go from 0 to 0.2 m; .* the length, 0.466 m"),
        ({"arclength_nodes": 5}, "has shape \\(\\)"),
        ({"time_rate": -10.0}, "time_rate holds -10"),
        ({"time_rate": "fast"}, "time_rate is 'fast'; give numbers"),
        ({"prior": None}, "prior is None; give a Prior"),
        ({"sensor_std": {"pose": [-1.0] * 6}}, "sensor_std of pose is .*; give numbers above 0"),
    ],
)
def test_a_robot_that_cannot_be_is_refused_as_its_file_is(change, said):
    refused(lambda: replace(ROBOT, **change), said)


def test_a_robot_takes_lists_and_pairs_of_deviations():
    made = Robot("mine", 0.466, [0.0, 0.2, 0.466], 10, ROBOT.prior, {"pose": [1e-3, 1e-2]})
    assert made.arclength_nodes.shape == (3,)
    np.testing.assert_allclose(made.sensor_std["pose"], np.repeat([1e-3, 1e-2], 3))
    refused(
        lambda: made.grid(1.0, 0.0), "from 1.0 to 0.0 s; give two numbers, the later one second"
    )


def test_what_the_caller_does_with_arrays_later_changes_nothing():
    psd, base = np.full(6, 0.1), np.eye(4)
    prior = SeparablePrior(psd, 0.5, BaseVariance(np.full(6, 1e-6), np.ones(6)), base_pose=base)
    time, value = np.linspace(0.0, 1.0, 3), np.zeros(6)
    grid = Grid(ROBOT.arclength_nodes, time)
    frame = SensorParameter("f", "frame", ("coil",), value, np.zeros(6))
    psd *= 4.0
    base[0, 3] = 1.0
    time += 5.0
    value += 1.0
    assert prior.psd_strain_arclength[0] == 0.1
    assert prior.base_pose[0, 3] == 0.0
    assert grid.time[0] == 0.0
    assert not frame.value.any()


def test_planning_says_what_it_needs():
    problem = predict_information(SLIDING, (0.64, 0.7), 2.0)
    zone, space = Zone((0.5, 0.6)), path_space_of(LIMITS, 0.7, 0.7, 2.0)
    path = path_objective_of(problem, [zone], Trace())
    for call, said in (
        (lambda: Zone(0.1, 0.15), r"0.1 cannot be; give both ends as \(0.6, 0.7\)"),
        (lambda: Zone("0.5:0.6"), "read_zone"),
        (lambda: Zone((0.1, 0.2, 0.3)), "give both ends"),
        (lambda: Zone((0.1, 0.2), 5.0), "give both ends"),
        (lambda: Zone((0.2, 0.1)), "empty; give the lower end first"),
        (lambda: MovingInterval((6.0, 0.0), (0.1, 0.2), (0.3, 0.4)), "lower end first"),
        (lambda: LogDet(7), "give 3, or 6"),
        (lambda: Worst(-2), "give a whole one from 1"),
        (lambda: Chance("5"), "bound of '5' m"),
        (lambda: path_objective_of(problem, zone, Trace()), "zones are a Zone and go in a list"),
        (lambda: path_objective_of(problem, [(0.5, 0.6)], Trace()), "zones hold a tuple"),
        (lambda: path_objective_of(problem, [zone], "trace"), "objective_named"),
        (lambda: path_objective_of(problem, [zone], Trace), "give Trace"),
        (lambda: path_objective_of(problem, [zone], Chance(5.0)), "5 m exceeds the robot's length"),
        (lambda: path_objective_of(SLIDING, [zone], Trace()), "give predict_information"),
        (lambda: predict_information(SLIDING.prior, (0.64, 0.7), 2.0), "give an estimate or a"),
        (lambda: plan_slide(SLIDING, space), "give path_objective_of"),
        (lambda: plan_slide(path, LIMITS), "give path_space_of"),
        (lambda: path_space_of((0.06, 0.024, 0.1), 0.7, 0.7, 2.0), "give SlideLimits"),
        (lambda: path_space_of(LIMITS, 0.7, 0.7, -1.0), "give two steps or more"),
        (lambda: path_space_of(LIMITS, 0.7, 0.7, 2.0, 0.0), "give two steps or more"),
        (lambda: evaluate_path(problem, [zone], Trace(), "path"), "give its arclengths"),
        (lambda: Replanner(space, space, [zone]), "give sliding_sensor"),
        (lambda: Replanner(problem.sensor, space, zone), "zones are a Zone"),
        (lambda: Replanner(problem.sensor, space, [zone], "trace"), "objective_named"),
    ):
        refused(call, said)
    assert path([0.7] * 20)[0] == path(np.full(20, 0.7))[0]
    flat = path_objective_of(problem, [zone], Chance(1e-9))
    with pytest.warns(PlanWarning, match="none is better than another"):
        plan_slide(flat, space, [zone])


def test_simulations_take_a_robot_and_a_path_and_say_what_they_need():
    held = SlidePath.hold(0.01, 0.5, LIMITS)
    session = simulate(SLIDING, slide=held, duration=0.5, without="all")
    assert session.coil.arclength == pytest.approx(0.69)
    for given, said in (
        ({"robot": ROBOT.prior}, "give its name, or the robot file"),
        ({"seed": "1"}, "Seed '1' cannot be"),
        ({"seed": 1.5}, "Seed 1.5 cannot be"),
        ({"duration": "2"}, "duration of '2' cannot be"),
        ({"cycles": 2.7}, "2.7 cycles cannot be"),
    ):
        refused(lambda given=given: simulate(**given), said)


def test_a_simulated_session_is_a_recording_in_the_world_frame():
    session = simulate(SLIDING, slide="hold", duration=0.5, without=["all"])
    recording = Recording.of(session.streams(), "mine", SLIDING)
    (seen,), _ = recording.readings(["coil"], SLIDING, (0.0, 0.5))
    np.testing.assert_allclose(seen.values, session.T_wt @ session.coil.values)
    assert recording.choose(None, None)[1] == list(session.mocap)
    for given, said in (
        (("coil", SLIDING, (0.0, 1.0)), r"give a list of names, \['coil'\]"),
        ((["coil"], "sliding700", (0.0, 1.0)), "give load_robot"),
        ((["coil"], SLIDING, None), "window is None; give first and last"),
        ((["coil"], SLIDING, (1.0, 0.0)), "1 to 0 s is empty; give T0 < T1"),
    ):
        refused(lambda given=given: recording.readings(*given), said)


def test_results_are_judged_saved_and_shown_only_if_they_are_results(tmp_path):
    grid, read = ROBOT.grid(0.0, 1.0), coil()
    posterior = estimate(ROBOT.prior, grid, [read])
    page = tmp_path / "view.html"
    for call, said in (
        (lambda: errors_against(read, posterior), "truth is a Posterior; give one stream"),
        (lambda: errors_against(ROBOT, read), "estimate is a Robot; give what estimate"),
        (lambda: errors_against(posterior, [read]), "truth is a list"),
        (lambda: check(posterior), "errors are a Posterior and go in a list"),
        (lambda: check(errors_against(posterior, read)), "errors are a Errors"),
        (lambda: check([errors_against(posterior, read)])[0].coverage(95), "give 0.95 for 95 %"),
        (
            lambda: save_posterior("a.nc", posterior),
            "posterior is a str; give what estimate returned",
        ),
        (lambda: load_posterior(posterior), "give the path of its file"),
        (lambda: save_view("v.html", posterior), "posterior is a str; give what estimate returned"),
        (lambda: save_view(posterior, page, readings=read), "go in a list"),
    ):
        refused(call, said)
    assert not page.exists()
    assert isinstance(posterior, Posterior)


def test_streams_of_one_label_keep_their_refused_rows_apart():
    streams = []
    for row, bend in ((1, 0.0), (3, 1e-5)):
        read = coil(name="")
        values = read.values + 0.0
        values[:, 0, 3] += bend
        values[row, 0, 3] += 0.1
        streams.append(read.changed(values=values))
    more = [coil(name=f"sound{k}", time=np.linspace(0.01 * k, 0.9, 5)) for k in range(1, 4)]
    found = estimate(ROBOT.prior, ROBOT.grid(0.0, 1.0), [*streams, *more])
    assert set(found.solve.refused) == {"CoilReadings", "CoilReadings 2"}
    assert 3 in found.solve.refused["CoilReadings 2"]


def test_streams_without_a_reading_are_named():
    with pytest.warns(EstimateWarning, match=r"None of the streams \(coil\) has a reading"):
        estimate(ROBOT.prior, ROBOT.grid(0.0, 1.0), [coil().select(slice(0, 0))])


def test_an_offset_known_to_much_more_than_the_recording_lasts_is_no_licence():
    late = SensorParameter("late", "time_offset", ("coil",), [20.0], [5.0])
    refused(
        lambda: estimate(ROBOT.prior, ROBOT.grid(0.0, 1.0), [coil()], sensor_parameters=[late]),
        "is 20 s, which puts most readings of coil outside",
    )


@pytest.mark.parametrize("ahead", [-60.0, 60.0])
def test_a_loop_that_uses_no_reading_for_their_times_says_so_once(ahead):
    def loop():
        smoother, tip = FixedLagSmoother(ROBOT.prior, ROBOT.arclength_nodes), coil()
        for k in range(60):
            values = tip.values[:1] + 0.0
            values[0, 0, 3] = 1e-5 * k
            read = tip.select(slice(0, 1)).changed(time=np.array([k / 30 + ahead]), values=values)
            smoother.add(read)
            smoother.advance(k / 30)

    with pytest.warns(EstimateWarning, match="of coil are left out: they lie before") as said:
        loop()
    assert len(said) == 1


def test_a_sensor_that_stays_is_given_its_arclength_once():
    tip = coil(arclength=ROBOT.length)
    np.testing.assert_array_equal(tip.arclength, np.full(5, ROBOT.length))
    assert len(tip.select(slice(1, 3))) == 2


def test_what_holds_arrays_is_shown_in_a_line_and_is_itself_alone():
    posterior = estimate(ROBOT.prior, ROBOT.grid(0.0, 1.0), [coil()])
    session = simulate(SLIDING, slide="hold", duration=0.5)
    smoother = FixedLagSmoother(ROBOT.prior, ROBOT.arclength_nodes)
    at = posterior.at(0.2, 0.5)
    for thing in (ROBOT, posterior, session, smoother, at, posterior.grid, coil()):
        assert len(repr(thing)) < 1500
        assert thing == thing
        assert thing in {thing}
    assert coil() != coil()
    assert "before its first update" in repr(smoother)
    smoother.add(coil())
    smoother.advance(1.0)
    assert "at 1 s, window 4, fits True" in repr(smoother)


def test_an_estimate_states_every_deviation():
    posterior = estimate(ROBOT.prior, ROBOT.grid(0.0, 1.0), [coil()])
    at = posterior.at([0.2, 0.4], 0.5)
    std = np.sqrt(np.diagonal(at.cov, axis1=-2, axis2=-1))
    np.testing.assert_allclose(at.std_rotation, np.linalg.norm(std[:, 3:6], axis=1))
    np.testing.assert_allclose(at.std_strain, std[:, 6:12])
    np.testing.assert_allclose(at.std_velocity, std[:, 12:])
