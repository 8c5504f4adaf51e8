"""Simulation-based calibration: uniformity of ranks in sessions drawn from the prior itself.

Draws sessions of `sbc.toml` (or another robot file), estimates each in batch and online, and checks
that the ranks of the truth are uniform inside simultaneous 95 % bands; then again with priors whose
standard deviations are 1.3 times too large and too small, which must fail.
Uniform ranks leave such bands in one of twenty runs by chance. If ranks of the right prior do,
three times as many new sessions are drawn: only quantities outside in both runs are a failure.
Usage: sbc.py [--robot FILE] [--sessions N] [--wrong N] [--seed N] [--json]   (some minutes)
Status 1: the right prior fails, or a wrong one passes in batch and online.
"""

import argparse
import json
from pathlib import Path

from glissando import load_robot
from glissando.evaluation.simulation_based import simulate_and_rank
from script import run, say

ROBOT = Path(__file__).with_name("sbc.toml")
WRONG = (1.3, 1 / 1.3)  # times the prior's standard deviations
MORE = 3  # ratio of sessions when ranks outside their bands are tested again


def judged(robot, sessions, wrong, seed):
    """Yield a dictionary per prior and estimator: right prior, repeated if outside, wrong ones."""
    right = list(ranked(robot, sessions, 1.0, seed))
    yield from right
    if any(map(outside, right)):
        yield from ranked(robot, MORE * sessions, 1.0, seed + 1)
    for factor in WRONG if wrong else ():
        yield from ranked(robot, wrong, factor, seed)


def ranked(robot, count, factor, seed):
    """Yield a dictionary per estimator, for the prior's standard deviations times a factor."""
    say(f"{count} sessions with a prior times {factor:.2f}")
    for check in simulate_and_rank(robot, count, prior_factor=factor, seed=seed):
        yield {"prior_factor": factor, **check.as_json()}


def outside(found):
    """Names of the quantities whose ranks leave their band."""
    return {q["name"] for q in found["quantities"] if not q["uniform"]}


def row(found):
    """Line of the table."""
    least = min(found["quantities"], key=lambda q: q["p_value"])
    count = len(outside(found))
    return (
        f"| × {found['prior_factor']:.2f} | {found['estimator']} | {found['sessions']} | "
        f"{found['not_converged']} | {least['p_value']:.2g} ({least['name']}) | "
        f"{f'not uniform: {count} quantities' if count else 'uniform'} |"
    )


def as_it_must(checks):
    """Whether the right prior passes with each estimator, and each wrong one fails with some."""
    always = {}  # quantities outside in every run
    for check in checks:
        names = always.setdefault(check["prior_factor"], {})
        names[check["estimator"]] = outside(check) & names.get(check["estimator"], outside(check))
    return all(any(names.values()) != (factor == 1.0) for factor, names in always.items())


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default=ROBOT, help="robot file or name")
    parser.add_argument("--sessions", type=int, default=1000, help="sessions with the prior")
    parser.add_argument("--wrong", type=int, default=200, help="sessions with each wrong prior")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    if options.sessions < 1 or options.wrong < 0:
        parser.error("--sessions is 1 or more, --wrong 0 or more")
    robot, found = load_robot(options.robot), []
    if not options.json:
        print("| prior's std | estimator | sessions | not converged | least chance | ranks |")
        print("|" + "---|" * 6)
    for each in judged(robot, options.sessions, options.wrong, options.seed):
        found.append(each)
        if not options.json:
            print(row(each), flush=True)
    if options.json:
        print(json.dumps({"robot": robot.name, "checks": found}))
    return 0 if as_it_must(found) else 1


if __name__ == "__main__":
    run(main)
