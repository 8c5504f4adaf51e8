"""`glissando plan` and `glissando design`: files and numbers, or one sentence and nothing."""

import json
import warnings

import numpy as np
import pytest

from command_line import run
from glissando import CoilReadings, estimate, load_robot
from glissando.cli.plan import _warn_of_better
from glissando.cli.progress import Work
from glissando.io.netcdf import save_posterior
from glissando.io.recording_folder import load_recording
from glissando.io.shipped_robots import robot_file
from glissando.planning import Design, pareto_front
from glissando.planning.compare import PathEvaluation
from glissando.visualization import planning_figures


@pytest.mark.slow
def test_a_planned_path_is_written_and_simulated_as_planned(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(planning_figures, "_TIMES", 9)  # pictures of a film, which take longest
    out, made = tmp_path / "plan", tmp_path / "made"
    asked = ("--zone", "0.5:0.6", "--horizon", 4, "--start", 0.69)
    assert run("plan", *asked, "--animate", "--out", out) == 0
    assert "variance against" in capsys.readouterr().out
    assert sorted(p.name for p in out.iterdir()) == [
        *("path.csv", "plan.gif", "plan.json", "plan.png")
    ]
    paths = json.loads((out / "plan.json").read_text())["paths"]
    assert paths["planned"]["std"] < min(paths["oscillating"]["std"], paths["fixed"]["std"])
    table = np.genfromtxt(out / "path.csv", delimiter=",", names=True)
    simulated = ("simulate", "--shape", "straight", "--slide", out / "path.csv", "--out", made)
    assert run(*simulated) == 0
    coil = load_recording(made).streams["coil"].rows
    knots = np.interp(coil.time, table["time"], table["arclength"])
    np.testing.assert_allclose(coil.arclength, knots, atol=3e-4)  # encoder, and parabolas
    assert coil.time[-1] == pytest.approx(4.0, abs=0.3)


@pytest.mark.slow
def test_json_alone_is_printed_and_says_what_every_path_is_worth(capsys):
    zones = ("--zone", "0.3:0.4@0:2", "--zone", "0.2:0.3..0.5:0.6@1:3*2")
    limits = ("--limits", "0.6,0.1,0.3", "--objective", "chance", "--bound", 0.01)
    assert run("plan", *zones, *limits, "--horizon", 3, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told["paths"]) == {"planned", "oscillating", "fixed", "random"}
    assert all(0.0 <= path["value"] <= 1.0 for path in told["paths"].values())
    assert told["paths"]["planned"]["value"] <= told["paths"]["oscillating"]["value"]


@pytest.mark.slow
def test_how_many_paths_are_still_to_be_compared_is_shown(capsys, monkeypatch):
    """At thousands of readings a second that is nearly all of the time."""
    shown = []
    monkeypatch.setattr(Work, "update", lambda work, *done: shown.append((work.doing, *done)))
    assert run("plan", "--zone", "0.5:0.6", "--horizon", 1, "--json") == 0
    json.loads(capsys.readouterr().out)
    parts = dict.fromkeys(doing for doing, *_ in shown)
    assert next(iter(parts)) == "planning"  # its search counts iterations
    for part in list(parts)[1:]:
        done, total = zip(*[counted for doing, *counted in shown if doing == part], strict=True)
        assert set(total) == {len(done)}
        assert list(done) == list(range(1, len(done) + 1))
    assert len(shown) >= 8


@pytest.mark.slow
def test_a_plan_goes_on_from_an_estimate(tmp_path, capsys):
    robot, time = load_robot("sliding700"), np.linspace(0.0, 2.0, 41)
    seen = np.tile(np.eye(4), (41, 1, 1))
    seen[:, 2, 3] = 0.65
    coil = CoilReadings(time=time, arclength=np.full(41, 0.65), values=seen, cov=1e-6)
    posterior = estimate(robot.prior, robot.grid(0.0, 2.0), [coil])
    save_posterior(posterior, tmp_path / "posterior.nc")
    given = "--zone", "0.5:0.6", "--horizon", 3, "--json"
    after = "--from", tmp_path / "posterior.nc"
    for others in ((), ("--robot", "tdcr466", "--limits", "0.06,0.024,0.1")):
        assert run("plan", *given, *after, *others) == 2
    told = capsys.readouterr().err
    assert "give --robot as well" in told
    assert "posterior is of a robot of 0.7 m, the plan of tdcr466 with 0.466 m" in told
    assert run("plan", *given, *after, "--robot", "sliding700") == 0
    known = json.loads(capsys.readouterr().out)["paths"]["fixed"]["std"]
    run("plan", *given)
    blank = json.loads(capsys.readouterr().out)["paths"]["fixed"]["std"]
    assert known < blank


def test_a_plan_is_as_good_as_what_it_is_compared_with_or_a_warning_says_so(capsys):
    """A way into which the rest at the end does not fit, and which the modes misjudge by 2 %."""
    assert run("plan", "--zone", "0.14:0.21", "--horizon", 4, "--json") == 0
    told = capsys.readouterr()
    paths = json.loads(told.out)["paths"]
    assert paths["planned"]["value"] < 1.01 * min(path["value"] for path in paths.values())
    assert paths["planned"]["value"] > paths["oscillating"]["value"]
    assert "The oscillating path does better" in told.err


@pytest.mark.parametrize(("share", "warned"), [(1e-5, False), (5e-3, True)])
@pytest.mark.parametrize("value", [-40.0, 2e-6])
def test_a_path_that_is_better_by_what_no_one_notices_is_no_reason_to_warn(value, share, warned):
    other = value - share * abs(value)
    values = {"planned": value, "oscillating": other, "fixed": value + abs(value)}
    results = {n: PathEvaluation(np.zeros(1), v, 0.0, 0.0) for n, v in values.items()}
    with warnings.catch_warnings(record=True, action="always") as seen:
        _warn_of_better(results)
    assert bool(seen) == warned


def test_a_mount_counts_by_the_stream_that_slides(tmp_path, capsys):
    file = tmp_path / "mine.toml"
    text = robot_file("sliding700").read_text(encoding="utf-8").replace('["coil"]', '["aurora"]')
    told = '\n[[sensor_parameters]]\nname = "m"\nkind = "mount"\nstreams = ["aurora"]\nstd = '
    file.write_text(text + told + "[5e-3, 0.05]\n", encoding="utf-8")
    given = "plan", "--robot", file, "--zone", "0.6:0.7", "--horizon", 1, "--json"
    std = []
    for stream in ((), ("--stream", "aurora")):
        assert run(*given, *stream) == 0
        told = capsys.readouterr()
        assert ("if the sensor slides as one of aurora" in told.err) == (not stream)
        std.append(json.loads(told.out)["paths"]["fixed"]["std"])
    assert std[1] > 1.2 * std[0]
    assert run(*given, "--stream", "aurroa") == 2
    assert "sensor parameters are of aurora; give one of these" in capsys.readouterr().err


@pytest.mark.slow
def test_how_many_designs_are_still_to_be_planned_is_shown(capsys, monkeypatch):
    shown = []
    monkeypatch.setattr(Work, "update", lambda work, *done: shown.append(done))
    sweep = ("--strokes", "0.03,0.06", "--speeds", "0.024", "--rates", "40", "--coils", "1,2")
    assert run("design", "--zone", "0.5:0.6", "--horizon", 1, "--json", *sweep) == 0
    assert len(json.loads(capsys.readouterr().out)["designs"]) == 4
    assert shown == [(1, 4), (2, 4), (3, 4), (4, 4)]


@pytest.mark.slow
def test_designs_are_compared_and_drawn(tmp_path, capsys):
    sweep = ("--strokes", "0.03,0.06", "--speeds", "0.024", "--rates", "40", "--coils", "1,2")
    given = ("--zone", "0.5:0.6", "--horizon", 2, "--out", tmp_path, "--json")
    assert run("design", *given, *sweep) == 0
    designs = json.loads(capsys.readouterr().out)["designs"]
    assert len(designs) == 4
    best = {(d["stroke"], d["coils"]): d["std"][0] for d in designs}
    assert best[0.06, 2] < best[0.06, 1]
    assert best[0.06, 2] < best[0.03, 2]
    assert (tmp_path / "design.png").stat().st_size > 10_000
    whole = ("--limits", "0.7,0.1,0.2", "--strokes", "0.7", "--speeds", "0.1", "--rates", "40")
    assert run("design", *given, *whole, "--coils", "1,2") == 0
    assert [d["coils"] for d in json.loads(capsys.readouterr().out)["designs"]] == [1]
    assert run("design", *given, *whole, "--coils", "2") == 2
    assert "No design has room for 2 coils" in capsys.readouterr().err


@pytest.mark.slow
def test_sensors_are_placed_within_a_budget(tmp_path, capsys):
    sensors = ("--sensor", "coil=1:1e-3,0.01", "--sensor", "gyro=0.5:0.01", "--sensor", "slide=2")
    given = ("--zone", "0:0.7", "--horizon", 1, "--places", 4, "--budget", 3)
    assert run("design", *given, *sensors, "--out", tmp_path, "--json") == 0
    rows = json.loads(capsys.readouterr().out)["placements"]
    assert [row["budget"] for row in rows] == [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    assert all(row["cost"] <= row["budget"] and row["bound"] <= row["std"] for row in rows)
    assert rows[-1]["std"] < rows[0]["std"]
    assert (tmp_path / "design.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--sensor", "coil"), "is not understood; give KIND=COST"),
        (("--sensor", "coil=0"), "give a cost above 0"),
        (("--sensor", "magnet=1"), "'magnet' is not a kind of sensor"),
        (("--sensor", "coil=2", "--budget", "1"), "the cheapest sensor costs 2"),
        (("--sensor", "coil=1", "--budget", "nan"), "A budget of nan cannot be"),
        (("--sensor", "coil=1", "--budget", "inf"), "A budget of inf cannot be"),
        (("--sensor", "coil=1:0.7"), "0.7 is not likely; give one number above 0"),
        (("--sensor", "gyro=1:90"), "for each of 3 rows, up to 5 rad/s"),
        (("--sensor", "fbg=1:-1e-5"), "-1e-05 is not likely"),
        (("--sensor", "coil=1:1e-3,0.6"), "0.6 rad is not likely: probably degrees"),
        (("--sensor", "coil=1:nan,0.01"), "nan, nan, nan, 0.01, 0.01 is not likely"),
        (("--sensor", "coil=1:1e-3,1e-3,1e-3"), "each of 5 rows, up to 0.05 m."),
    ],
)
def test_sensors_that_cannot_be_placed_say_why(arguments, said, capsys):
    assert run("design", "--zone", "0:0.7", "--places", 2, "--horizon", 1, *arguments) == 2
    assert said in capsys.readouterr().err


def test_a_design_that_costs_more_for_the_same_is_not_worth_it():
    def made(stroke, coils, std):
        return Design(stroke, 0.024, 40.0, coils, 0.0, (std,))

    designs = [made(0.03, 1, 9.0), made(0.06, 1, 6.0), made(0.06, 2, 5.95), made(0.03, 2, 9.5)]
    assert pareto_front(designs).tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--zone", "0.5"), "Zone '0.5' is not understood"),
        (("--zone", "0.5:0.9"), "the body from 0 to 0.7 m"),
        (("--zone", "0.5:0.6@20:30"), "Plan farther ahead"),
        (("--zone", "0.5:0.6", "--limits", "0.06,0.02"), "STROKE,SPEED,ACCEL"),
        (("--zone", "0.5:0.6", "--limits", "0.06,0,1"), "a speed of 0 m/s"),
        (("--zone", "0.5:0.6", "--start", "0.2"), "off its slide from 0.64 to 0.7 m"),
        (("--zone", "0.5:0.6", "--robot", "tdcr466"), "give --limits"),
        (
            ("--zone", "0.5:0.6", "--robot", "extensible1m", "--limits", "0.5,0.1,0.1"),
            "Give the prior a firmer base",
        ),
        (("--zone", "0.5:0.6", "--node-step", "0"), "Time nodes 0 s apart"),
        (("--zone", "0.5:0.6", "--node-step", "1e-4"), "steps of a path, 0.1 s each"),
        (("--zone", "0.5:0.6", "--node-step", "1e9"), "give 0.1 to 2 s"),
        (("--zone", "0.5:0.6", "--rate", "1e9"), "give 10000 Hz at most"),
        (("--zone", "0.5:0.6", "--seed", "-1"), "--seed is -1"),
        (("--zone", "0.5:0.6", "--speed-weight", "nan"), "weight of nan cannot be"),
        (("--zone", "0.5:0.6", "--speed-weight", "-1"), "weight of -1 cannot be"),
        (("--zone", "0.5:0.6", "--limits", "0.06,0.024,100"), "100 m/s² is more than 50"),
        (("--zone", "0.5:0.6", "--rate", "0"), "at 0 Hz reads nothing"),
        (("--zone", "0.5:0.6", "--horizon", "0.1"), "two steps or more"),
        (("--zone", "0.5:0.6", "--objective", "chance", "--bound", "-1"), "bound of -1 m"),
        (("--zone", "0.5:0.6", "--objective", "chance", "--bound", "5"), "length, 0.7 m; give m"),
        (("--zone", "0.5:0.6", "--limits", "0.06,24,100"), "24 mm/s are 0.024 m/s"),
        (("--zone", "0.5:0.6", "--horizon", "3000"), "3000 milliseconds are 3 s"),
    ],
)
def test_mistakes_are_told_in_one_sentence(arguments, said, capsys):
    assert run("plan", "--horizon", 2, *arguments) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--speeds", "20"), "20 mm/s are 0.02 m/s"),
        (("--coils", "1,nan"), "give whole numbers from 1 to 100"),
        (("--coils", "1e9"), "give whole numbers from 1 to 100"),
        (("--sensor", "coil=1", "--places", "100000"), "give 1 to 1000"),
        (("--horizon", "3000"), "3000 milliseconds are 3 s"),
        (("--sensor", "coil=1", "--horizon", "3000"), "3000 milliseconds are 3 s"),
        (("--objective", "chance", "--bound", "5"), "length, 0.7 m; give m"),
    ],
)
def test_wrong_units_of_a_design_are_told(arguments, said, capsys):
    assert run("design", "--zone", "0:0.7", "--horizon", 1, *arguments) == 2
    assert said in capsys.readouterr().err
