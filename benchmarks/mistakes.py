"""Detection rates of the guard for mistakes of new users, and its false alarms.

Each kind of mistake is applied, with random parameters, to recordings and simulated sessions;
correct detections are counted, and findings in correct sessions. Sessions with undetected mistakes
are estimated, to see if the result changes by more than its σ (`--all` estimates all sessions).
Thresholds were chosen on TUNED_ON; `--report` draws from REPORTED_ON instead.

Usage: mistakes.py --recording FOLDER [--recording FOLDER …] [--robot FILE] [--window T0 T1]
       [--sessions N] [--mistaken N] [--draws N] [--report | --first-seed SEED] [--no-truth]
       [--correct] [--only NAMES] [--quick | --all] [--json]
"""

import argparse
import json
import os
import time
import warnings
from dataclasses import replace
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

import mistakes_of_exports  # noqa: F401 (fills MISTAKES)
import mistakes_of_place  # noqa: F401
import mistakes_of_streams  # noqa: F401
from glissando import estimate, load_recording, load_robot
from glissando.errors import GlissandoError
from glissando.evaluation.metrics import errors_against
from glissando.evaluation.plausibility.examine import examine
from glissando.evaluation.run import checked_window, chosen_streams
from glissando.experiments import scenes
from mistake_kinds import MISTAKES, Session

TUNED_ON = {
    "seeds": [
        *range(5000, 5200),
        *range(9000, 9200),
        *range(20000, 20200),
        *range(30000, 30100),
        *range(40000, 40200),
    ],
    "draws": range(0, 100),
}
REPORTED_ON = {"seeds": range(60000, 60400), "draws": range(1000, 1100)}
"""Seeds of simulated sessions and of random mistakes: thresholds were chosen on the former."""

SHAPES = (*scenes.TUNED_ON, *scenes.REPORTED_ON)
FLAWS = ("jitter", "bias", "registration", "play", "backlash", "dropouts", "set_curvature", "mocap")


def session_of(folder, robot, window):
    recording = load_recording(folder)
    robot = robot or recording.robot
    window = checked_window(recording, window)
    readings, truth, _ = chosen_streams(recording, robot, window, None, None)
    return Session(robot, tuple(readings), tuple(truth), recording.frames), window


def windows_of(folder):
    """Windows of a recording: the whole (None), then all of 10 s."""
    first, last = load_recording(folder).span()
    return [None, *((t, t + 10.0) for t in np.arange(first, last - 10.0, 10.0))]


def simulated(seed):
    """Simulated session with random shape, slide, speed and noise, and its window."""
    rng = np.random.default_rng(seed)
    slide = str(rng.choice(["hold", "oscillate", "traverse"]))
    scene = scenes.Scene(
        shape=str(rng.choice(SHAPES)),
        slide=slide,
        duration=float(rng.uniform(8.0, 20.0)),
        speed=float(rng.uniform(0.05, 0.25) if slide == "traverse" else rng.uniform(0.01, 0.024)),
        at=float(rng.uniform(0.0, 0.3)) if slide == "hold" else 0.0,
        stroke=0.7 if slide == "traverse" else float(rng.uniform(0.03, 0.06)),
        cycles=1 if slide == "traverse" else int(rng.integers(1, 4)),
        flaws=tuple((flaw, float(np.exp(rng.normal(0.0, 0.5)))) for flaw in FLAWS),
    )
    if rng.random() < 0.1:
        scene = replace(scene, flaws=tuple((flaw, 0.0) for flaw in FLAWS))
    recording, robot = scenes.recording(scene, seed), scenes.known_robot(scene)
    window = recording.span()
    readings, truth, _ = chosen_streams(recording, robot, window, None, None)
    frames = {"coil": scenes.bench(scene.robot).tracker}
    return Session(robot, tuple(readings), tuple(truth), frames), window


def looked_at(session, window):
    """Findings of the guard, and its time (s); errors of reading count as findings."""
    start = time.perf_counter()
    for r in session.sensors + session.truth:
        if np.any((r.arclength < -1e-9) | (r.arclength > session.robot.length + 1e-9)):
            return {"reading": f"{r.label} lies outside the robot"}, time.perf_counter() - start
    times = [r.time for r in session.sensors]
    window = window or (min(t[0] for t in times), max(t[-1] for t in times))
    found = examine(
        session.robot, session.sensors, session.truth, frames=session.frames, window=window
    )
    return {f.name: f.sentence for f in found}, time.perf_counter() - start


def answer(session, window):
    """Posterior of a session."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        grid = session.robot.grid(*window)
        return estimate(
            session.robot.prior, grid, [r.inside(grid) for r in session.sensors],
            sensor_parameters=session.robot.sensor_parameters,
        )  # fmt: skip


def changed(right, session, wrong, window):
    """RMS change of the estimate by a mistake, or of its reported errors, in σ; inf on failure."""
    std = np.sqrt(np.sum(right.std_pose()[..., :3] ** 2, axis=-1))
    of_truth = all(a is b for a, b in zip(wrong.sensors, session.sensors, strict=True))
    if of_truth and wrong.robot is session.robot:
        rmse = [
            np.sqrt(np.mean(np.concatenate([
                errors_against(right, t.inside(right.grid)).position for t in each.truth
            ]) ** 2))
            for each in (session, wrong)
        ]  # fmt: skip
        return float(abs(rmse[1] - rmse[0]) / np.sqrt(np.mean(std**2)))
    try:
        position = answer(wrong, window).state.pose[..., :3, 3]
    except (GlissandoError, np.linalg.LinAlgError):
        return np.inf
    shift = np.linalg.norm(position - right.state.pose[..., :3, 3], axis=-1)
    return float(np.sqrt(np.mean((shift / std) ** 2)))


def judge(name, session, window, draws, every):
    """Rows for each mistake applied to a session, `draws` times."""
    rows, right = [], None
    for kind, (make, checks) in MISTAKES.items():
        for draw in draws:
            rng = np.random.default_rng([draw, *kind.encode()])
            wrong = make(rng, session)
            if wrong is None:
                continue
            late = kind.startswith(("all times", "one sensor", "one_sensor"))
            found, seconds = looked_at(wrong, None if late else window)
            row = {"session": name, "mistake": kind, "draw": draw, "seconds": seconds,
                   "found": found, "named": bool(checks & found.keys()), "moved": None}  # fmt: skip
            if every is not None and (every or not row["named"]):
                right = right or answer(session, window)
                row["moved"] = changed(right, session, wrong, window)
            rows.append(row)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recording", type=Path, action="append", default=[])
    parser.add_argument("--robot", type=load_robot)
    parser.add_argument("--window", type=float, nargs=2)
    parser.add_argument("--sessions", type=int, default=0, help="simulated, for false alarms")
    parser.add_argument("--mistaken", type=int, default=0, help="simulated, with every mistake")
    parser.add_argument("--report", action="store_true", help="seeds that tuned nothing")
    parser.add_argument("--first-seed", type=int, help="of simulated sessions, in place of lists")
    parser.add_argument("--correct", action="store_true",
                        help="recordings as they are: whole, and every 10 s")  # fmt: skip
    parser.add_argument("--only", default="", help="mistakes whose name holds one of these, by |")
    parser.add_argument("--draws", type=int, default=1, help="of each mistake")
    parser.add_argument("--no-truth", action="store_true", help="leave truth out")
    parser.add_argument("--all", action="store_true", help="estimate every mistake, named or not")
    parser.add_argument("--quick", action="store_true", help="estimate nothing; all of them count")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    drawn = REPORTED_ON if options.report else TUNED_ON
    for kind in list(MISTAKES):
        if not any(part in kind for part in options.only.split("|")):
            del MISTAKES[kind]
    draws, rows, alarms, seconds = drawn["draws"][: options.draws], [], {}, []

    def blind(session):
        return Session(session.robot, session.sensors, (), session.frames)

    def take(name, session, window, mistaken):
        session = blind(session) if options.no_truth else session
        found, took = looked_at(session, window)
        seconds.append(took)
        if found:
            alarms[name] = found
        if mistaken:
            rows.extend(judge(name, session, window, draws, None if options.quick else options.all))

    for folder in options.recording:
        for window in windows_of(folder) if options.correct else (options.window,):
            label = f"{folder.name} {window}" if options.correct else folder.name
            take(label, *session_of(folder, options.robot, window), not options.correct)
    first, count = options.first_seed, max(options.sessions, options.mistaken)
    seeds = drawn["seeds"][:count] if first is None else range(first, first + count)
    for k, seed in enumerate(seeds):
        take(f"simulated {seed}", *simulated(seed), k < options.mistaken)
    report(rows, alarms, seconds, options)


def report(rows, alarms, seconds, options):
    counted = [r for r in rows if r["named"] or r["moved"] is None or r["moved"] > 1.0]
    summary = {
        "kinds": len({r["mistake"] for r in rows}),
        "mistakes": len(rows),
        "that count": len(counted),
        "named": sum(r["named"] for r in counted),
        "correct sessions": len(seconds),
        "false alarms": len(alarms),
        "seconds of a correct session": float(np.median(seconds)),
    }
    if options.json:
        print(json.dumps({"summary": summary, "alarms": alarms, "rows": rows}, default=float))
        return
    for row in rows:
        if not row["named"]:
            moved = "" if row["moved"] is None else f"moves the answer by {row['moved']:.3g} σ"
            named = "; ".join(f"{n}: {s}" for n, s in row["found"].items()) or "nothing"
            print(f"{row['session']}: {row['mistake']} ({moved}) → {named}")
    for name, found in alarms.items():
        print(f"FALSE ALARM {name}: {found}")
    for key, value in summary.items():
        print(f"{key}: {value:.4g}" if isinstance(value, float) else f"{key}: {value}")
    if counted:
        print(f"share named of those that count: {summary['named'] / len(counted):.1%}")


if __name__ == "__main__":
    main()
