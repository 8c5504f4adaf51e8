"""Write into docs/planning.md the gain of planned paths, on physics unknown to the planner.

The paper's 0.70 m robot holds a C, an S, or moves from one to the other in 20 s. The task is its
position from 0.50 to 0.60 m. The path is planned with the nominal shape; then 5 robots, each with
its own permanent set that is in no model, are simulated with 10 draws of all sensors' errors each,
and estimated. "everywhere" is predicted for sensors at all places of the stroke at once, as a bound
for every path. The last three columns are relative to oscillating: mean predicted variance, mean
variance of the estimates, and mean squared error against the true motion.
Usage: plan_study.py [ROBOTS [DRAWS]]
"""

import os
import sys
import warnings
from dataclasses import replace
from datetime import date

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from scipy.stats import chi2

from glissando import CoilReadings, NotConvergedWarning, estimate, load_robot
from glissando.io.shipped_robots import robot_file
from glissando.planning import (
    Trace,
    Zone,
    baseline_paths,
    evaluate_everywhere,
    evaluate_path,
    expected_motion,
    path_objective_of,
    path_space_of,
    plan_slide,
    predict_information,
)
from glissando.simulation import SlidePath, load_bench, simulate_session
from plan_page import table, write

LASTS, ZONE = 20.0, Zone((0.5, 0.6))
ROBOT = replace(  # time rate (Hz) of the planner; no parameters of the coil are estimated
    load_robot("sliding700"), time_rate=2.0, sensor_parameters=()
)
BENCH = load_bench(robot_file("sliding700"))
TIP = BENCH.rod.length
STAGES = {"60 mm": BENCH.slide, "700 mm": BENCH.full_slide}
SHAPES = ("C", "S", "C-to-S")


def moved(shape, robot):
    """Motion of the robot with a number, which draws its set; nominal, without set, if None."""
    flaws = BENCH.flaws.without("set") if robot is None else BENCH.flaws
    return BENCH.move(BENCH.shape(shape).lasting(LASTS), flaws, robot or 0)


def expected(motion):
    """Nominal motion in the form that the planner expects."""

    def shape(arclength, time):
        at = motion.at(arclength, time)
        return at.pose, at.strain

    return expected_motion(shape, ROBOT.prior, ROBOT.arclength_nodes)


def paths_of(problem, stage):
    """Paths of the slide by name, with the coil's arclengths at the problem's times."""
    path_space = path_space_of(stage, TIP, TIP, LASTS)
    plan = plan_slide(path_objective_of(problem, [ZONE], Trace()), path_space, [ZONE])
    cycles = int(np.ceil(LASTS / (2.0 * stage.stroke / stage.speed)))
    slides = {
        "planned": plan.slide_path(TIP, stage),
        "oscillating": SlidePath.oscillate(cycles, stage.stroke, stage),
        "fixed": SlidePath.hold(0.0, LASTS, stage),
    }
    assert set(slides) < {"planned", *baseline_paths(stage, TIP, TIP, path_space.times)}
    return {name: (slide, TIP - slide.at(problem.times)) for name, slide in slides.items()}


def simulated(motion, slide, seed, start):
    """Mean posterior variance, squared error and coverage in the zone; and the state."""
    recorded = simulate_session(BENCH, motion, slide, seed=seed, duration=LASTS)
    rows = recorded.coil
    coil = CoilReadings(
        time=rows.time, arclength=rows.arclength, values=recorded.T_wt @ rows.values,
        cov=ROBOT.sensor_std["coil"] ** 2, name="coil",
    )  # fmt: skip
    posterior = estimate(ROBOT.prior, ROBOT.grid(0.0, LASTS), [coil], initial=start)
    place, time = ZONE.points(np.arange(0.25, LASTS, 0.5))
    at, true = posterior.at(place, time), motion.at(place, time).pose[:, :3, 3]
    error, cov = at.position - true, at.cov_position_world
    nees = np.einsum("zi,zi->z", error, np.linalg.solve(cov, error[..., None])[..., 0])
    inside = np.mean(nees <= chi2.ppf(0.95, 3))
    return [np.mean(at.std_position**2), np.mean(np.sum(error**2, 1)), inside], posterior.state


def study(shape, stage, robots, draws):
    """Predicted σ (m) by path; posterior variance, squared error and coverage of each run."""
    motion = expected(moved(shape, None))
    reach = TIP - stage.stroke, TIP
    problem = predict_information(
        ROBOT, reach, LASTS, motion=motion, node_step=1.0 / ROBOT.time_rate
    )
    predicted, runs = {"everywhere": evaluate_everywhere(problem, [ZONE], Trace()).std}, {}
    paths = paths_of(problem, stage)
    for name, (_, path) in paths.items():
        predicted[name], runs[name] = evaluate_path(problem, [ZONE], Trace(), path).std, []
    for robot in range(robots):
        motion, state = moved(shape, robot), None
        for name, (slide, _) in paths.items():
            for draw in range(draws):
                result, state = simulated(motion, slide, draws * robot + draw, state)
                runs[name].append(result)
    return predicted, {name: np.array(results) for name, results in runs.items()}


def row_of(label, shape, name, std, predicted, runs):
    """Cells of a path's row, and its three changes relative to oscillating (%)."""
    row, blind = [label, shape, name, f"{1e3 * std:.2f}"], runs["oscillating"].mean(axis=0)
    claimed = square = np.nan
    if name in runs:
        claimed, square, inside = runs[name].mean(axis=0)
        row += [f"{1e3 * np.sqrt(x):.2f}" for x in (claimed, square)] + [f"{100 * inside:.0f} %"]
    else:
        row += [""] * 3
    shares = (std / predicted["oscillating"]) ** 2, claimed / blind[0], square / blind[1]
    changes = [100.0 * (share - 1.0) for share in shares]
    return row + [f"{x:+.0f} %" if np.isfinite(x) else "" for x in changes], changes


def between(numbers):
    """Range of reductions (the negative of changes), as text."""
    least, most = sorted(-np.array(numbers))[:: len(numbers) - 1]
    return f"{least:.0f} to {most:.0f} %" if round(least) != round(most) else f"{least:.0f} %"


def main(robots=5, draws=10):
    """Write the table of every shape, stage and path, and its summary."""
    warnings.simplefilter("ignore", NotConvergedWarning)
    rows, sentences, off = [], [], []
    for label, stage in STAGES.items():
        gains = []
        for shape in SHAPES:
            predicted, runs = study(shape, stage, robots, draws)
            for name, std in predicted.items():
                cells, changes = row_of(label, shape, name, std, predicted, runs)
                rows.append(cells)
                print(*cells, sep=" | ", flush=True)
                if name in runs:
                    off.append(abs(np.sqrt(runs[name][:, 0].mean()) / std - 1.0))
                if name == "planned":
                    gains.append(changes)
        variance, _, square = (between(part) for part in np.transpose(gains))
        sentences.append(
            f"Against an oscillation over a stroke of {label} the plan is predicted to leave "
            f"{variance} less variance, and leaves {square} less squared error."
        )
    heads = "stroke", "shape", "path", "σ predicted (mm)", "σ claimed", "RMSE", "inside 95 %"
    heads += "variance predicted", "claimed", "squared error"
    sentences.append(
        f"The deviation predicted without any reading agrees with what the estimator claims "
        f"afterwards within {np.ceil(100 * max(off)):.0f} %."
    )
    ran = f"`benchmarks/plan_study.py`, {date.today()}, {robots} robots, {draws} draws each."
    write("worth", [*table(heads, rows), "", *sentences, "", ran])


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:3]))
