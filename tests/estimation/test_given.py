"""What an estimate is given is checked: kinds, gates, units and places are one sentence each."""

import dataclasses

import numpy as np
import pytest

from glissando import (
    FbgReadings,
    FixedLagSmoother,
    GlissandoError,
    Grid,
    PositionReadings,
    Posterior,
    SensorParameter,
    SolverOptions,
    estimate,
    estimate_static,
    load_recording,
    load_robot,
    uniform_grid,
)
from glissando.errors import OutsideGridError, SensorError
from glissando.geometry import se3
from mechanical_rod import mechanical
from scenes import sliding_scene


def framed(value, *, kind="frame", std=None):
    return SensorParameter("f", kind, ("coil",), value, np.zeros(6) if std is None else std)


def test_an_argument_of_another_kind_is_one_sentence():
    prior, grid, readings = sliding_scene()
    robot, nodes = load_robot("tdcr466"), grid.arclength
    offset = SensorParameter("home", "arclength_offset", ("coil",), [0.0], [1e-3])
    posterior = Posterior(*[None] * 8)
    smoother = FixedLagSmoother(prior, nodes)
    for call, said in (
        (lambda: load_robot(3), "load_robot was given 3; give a robot's name"),
        (lambda: load_recording(None), "load_recording was given None; give a recording's folder"),
        (lambda: robot.grid("0", 1), "A grid goes from '0' to 1 s; give two numbers"),
        (lambda: estimate("tdcr466", grid, readings), "prior is a str; give a Robot or a Prior"),
        (lambda: estimate(prior, nodes, readings), r"grid is a ndarray; give robot.grid\("),
        (
            lambda: estimate(prior, grid, readings[0]),
            "readings are a PoseReadings and go in a list",
        ),
        (lambda: estimate(prior, grid, [readings]), "readings hold a list; give a list"),
        (lambda: estimate(prior, grid, readings, initial=posterior), "give posterior.states_on"),
        (lambda: estimate(prior, grid, readings, options={}), "options is a dict; give Solver"),
        (lambda: estimate(prior, grid, readings, sensor_parameters=offset), "a list of Sensor"),
        (lambda: FixedLagSmoother(prior, nodes, sensor_parameters=[offset] * 2), "'home'; rename"),
        (lambda: FixedLagSmoother(None, nodes), "prior is a NoneType; give a Robot"),
        (lambda: FixedLagSmoother(prior, nodes, window=2.5), "2.5; give a whole number"),
        (lambda: FixedLagSmoother(prior, 1e3 * nodes), "466 m; give metres"),
        (lambda: smoother.add(readings), "stream is a list; give the readings of one"),
        (lambda: estimate_static("tdcr466", nodes, []), "prior is a str; give a Robot"),
        (lambda: dataclasses.replace(offset, streams="coil"), "streams is 'coil'; give a list"),
        (lambda: dataclasses.replace(offset, streams=None), "streams is None; give a list"),
        (lambda: dataclasses.replace(offset, kind=["frame"]), "choose one of"),
        (lambda: estimate(type(prior), grid, readings), "prior is a .*; give a Robot"),
        (lambda: estimate(prior, grid, readings, gate="a"), "gate is 'a'"),
        (lambda: framed([0, 0, 0, 90.0, 0, 0]), "give radians"),
        (lambda: framed([250.0, 0, 0, 0, 0, 0]), "give metres"),
        (lambda: framed([20.0, 0, 0, 0, 0, 0], kind="mount"), "give metres"),
        (lambda: framed(np.zeros(6), std=np.full(6, 90.0)), "std is .*; give metres"),
        (lambda: dataclasses.replace(prior, rest_strain=[0, 0, 1e3, 0, 0, 0]), "extension of 1000"),
        (lambda: SolverOptions(max_iterations="5"), "max_iterations is '5'; give 1 or more"),
        (lambda: SolverOptions(max_iterations=0), "max_iterations is 0"),
        (lambda: SolverOptions(tolerance=np.nan), "tolerance is nan; give standard deviations"),
        (lambda: SolverOptions(tolerance=-1.0), r"tolerance is -1\.0"),
        (lambda: Grid(["a"], [0.0]), "Grid arclength must be a list of finite numbers"),
        (lambda: Grid([0.0], [0.0, 1.0], before="a"), "The node before the grid, 'a'"),
        (lambda: uniform_grid(0.5, 5, 0.0, 1.0, np.inf), "give positive numbers"),
        (lambda: uniform_grid(0.5, -2, 0.0, 1.0, 10.0), "give positive numbers"),
        (lambda: uniform_grid(0.5, 5, 0.0, 1.0, 1e12), "give positive numbers"),
        (lambda: estimate_static(prior, ["a"], []), "arclength nodes are"),
        (lambda: estimate_static(prior, nodes, [], count=2.0), "count is 2.0; give how many"),
        (lambda: FixedLagSmoother(prior, "a"), "arclength nodes are 'a'"),
        (lambda: estimate(prior, grid, readings).sample(0), "rng is 0; give numpy.random"),
    ):
        with pytest.raises(GlissandoError, match=said):
            call()


def test_an_offset_in_another_unit_is_one_sentence():
    prior, grid, (base, coil, gyro) = sliding_scene()
    for kind, value, said in (
        ("time_offset", 30.0, "'off' is 30 s, which puts most readings of coil outside"),
        ("arclength_offset", -5.0, "'off' is -5 m, which puts most readings"),
    ):
        off = SensorParameter("off", kind, ("coil",), [value], [0.01])
        with pytest.raises(OutsideGridError, match=said):
            estimate(prior, grid, [base, coil, gyro], sensor_parameters=[off])


def test_a_mount_of_what_has_none_is_not_estimated():
    robot = load_robot("tdcr466")
    fibre = FbgReadings(
        time=[0.0], arclength=[0.1], values=[[0.0]], cov=1e-8, core_radius=[1e-4], core_angle=[0.0],
        name="fibre",
    )  # fmt: skip
    mount = SensorParameter("roll", "mount", ("fibre",), np.zeros(6), np.full(6, 0.1))
    with pytest.raises(SensorError, match="have no mount; leave sensor parameter 'roll'"):
        estimate(robot.prior, robot.grid(0.0, 0.2), [fibre], sensor_parameters=[mount])


@pytest.mark.parametrize("gate", [2.0, 1.0, 0.0, -1.0, np.nan])
def test_a_gate_that_is_no_chance_is_one_sentence(gate):
    robot = load_robot("tdcr466")
    with pytest.raises(SensorError, match="the chance, between 0 and 1"):
        estimate(robot.prior, robot.grid(0.0, 1.0), [], gate=gate)
    with pytest.raises(SensorError, match="the chance, between 0 and 1"):
        FixedLagSmoother(robot.prior, robot.arclength_nodes, gate=gate)


def in_millimetres(robot, time):
    """Positions of an arc at three places, each at one of three times."""
    place = robot.length * np.array([0.3, 0.7, 1.0])
    bent = se3.exp(place[:, None] * np.array([0.0, 0.0, 1.0, 0.0, 0.8, 0.0]))
    data = {"arclength": place, "values": 1e3 * bent[:, :3, 3], "cov": 1e-6, "name": "seen"}
    return PositionReadings(time=np.broadcast_to(time, 3), **data)


FAR_OFF = r"No shape of this robot.*Check units"


@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments", "sliding700"])
def test_static_shapes_in_millimetres_are_one_sentence(name):
    robot = load_robot(name)
    with pytest.raises(SensorError, match=FAR_OFF):
        estimate_static(robot.prior, robot.arclength_nodes, [in_millimetres(robot, 0.0)])


@pytest.mark.slow
def test_updates_in_millimetres_are_one_sentence():
    robot = load_robot("tdcr466")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)

    def go():
        for now in 0.1 * np.arange(20):
            smoother.add(in_millimetres(robot, now))
            smoother.advance(now)

    with pytest.raises(SensorError, match=FAR_OFF):
        go()


def test_readings_off_the_grid_are_named():
    prior, grid, (_, coil, _) = sliding_scene()
    arclength = coil.arclength.copy()
    arclength[[3, 17]] = 0.481, 0.502
    off = dataclasses.replace(coil, arclength=arclength)
    with pytest.raises(OutsideGridError, match=r"rows 3, 17 have arclength 0.481, 0.502 m"):
        estimate(prior, grid, [off])
    assert len(off.inside(grid)) == len(coil) - 2


@pytest.mark.parametrize(
    ("field", "values", "sentence"),
    [
        ("time", np.array(["2026-01-01", "2026-01-02"], "datetime64[s]"), "give numbers, times in"),
        ("time", np.array([1, 2], "timedelta64[ms]"), r"type timedelta64\[ms\]; give numbers"),
        ("values", np.ones((2, 3)) + 0j, "type complex128; give numbers"),
        ("values", np.ma.masked_equal([[1.0, 1.0, 1.0], [1.0, 9.0, 1.0]], 9.0), "row 1 is masked"),
        ("time", np.ma.masked_equal([9.0, 1.0], 9.0), "time of row 0 is masked; drop masked rows"),
    ],
)
def test_dates_complex_numbers_and_masked_rows_are_no_readings(field, values, sentence):
    """numpy makes numbers of them: nanoseconds, real parts, and what stands under the mask."""
    given = {"time": [0.0, 1.0], "arclength": [0.1, 0.1], "values": np.ones((2, 3)), field: values}
    with pytest.raises(SensorError, match=f"seen: .*{sentence}"):
        PositionReadings(**given, cov=1e-6, name="seen")


def test_nodes_that_begin_beyond_a_base_are_refused():
    robot, (_, _, readings) = load_robot("tdcr466"), sliding_scene()
    nodes = np.array([0.1, 0.2, 0.466])
    with pytest.raises(OutsideGridError, match=r"begin at 0\.1 m, and the prior says where"):
        estimate(robot.prior, Grid(nodes, [0.0, 1.0]), readings)
    with pytest.raises(OutsideGridError, match="begin at 0"):
        FixedLagSmoother(robot.prior, nodes)


@pytest.mark.parametrize(
    "time", ["4", np.array([3.1]), np.datetime64("2026-01-01"), np.nan, None, 1 + 0j]
)
def test_a_time_that_is_no_number_is_one_sentence(time):
    robot = load_robot("tdcr466")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    smoother.advance(0.0)
    with pytest.raises(OutsideGridError, match=r"time to advance to is .*; give seconds, a number"):
        smoother.advance(time)
    smoother.advance(np.float32(0.5))
    assert smoother.time == 0.5


def test_places_and_times_of_a_query_are_numbers_that_fit_together():
    robot = load_robot("tdcr466")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    smoother.advance(0.0)
    for place, time in (("tip", 0.0), ([0.1, 0.2], [0.0, 0.0, 0.0]), (0.1, np.datetime64("2026"))):
        for asked in (smoother, smoother.posterior()):
            with pytest.raises(OutsideGridError, match="Places and times are numbers, m and s"):
                asked.at(place, time)


def test_a_rod_of_one_node_is_refused():
    with pytest.raises(OutsideGridError, match="two arclength nodes or more"):
        FixedLagSmoother(mechanical(points=np.zeros(0), var_points=np.zeros((0, 6))), [0.0])
