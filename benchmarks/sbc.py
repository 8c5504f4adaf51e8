"""Simulation-based calibration: is confidence true of sessions drawn from the prior itself.

Draws sessions of `sbc.toml` (or another robot file), estimates each in batch and online, and checks
that the ranks of the truth are uniform inside simultaneous 95 % bands; then again with priors whose
standard deviations are 1.3 times too large and too small, which must fail.
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


def judged(robot, sessions, wrong, seed):
    """A dictionary a prior and estimator: the right prior, then the wrong ones."""
    for factor, count in ((1.0, sessions), *((f, wrong) for f in WRONG)):
        if count:
            say(f"{count} sessions with a prior times {factor:.2f}")
            for check in simulate_and_rank(robot, count, prior_factor=factor, seed=seed):
                yield {"prior_factor": factor, **check.as_json()}


def row(found):
    """A line of the table."""
    least = min(found["quantities"], key=lambda q: q["p_value"])
    outside = [q["name"] for q in found["quantities"] if not q["uniform"]]
    return (
        f"| × {found['prior_factor']:.2f} | {found['estimator']} | {found['sessions']} | "
        f"{found['not_converged']} | {least['p_value']:.2g} ({least['name']}) | "
        f"{'uniform' if not outside else f'not uniform: {len(outside)} quantities'} |"
    )


def as_it_must(checks):
    """Whether the right prior passes with each estimator, and each wrong one fails with one."""
    uniform = {}
    for check in checks:
        ranks = all(q["uniform"] for q in check["quantities"])
        uniform.setdefault(check["prior_factor"], []).append(ranks)
    return all(all(u) if factor == 1.0 else not all(u) for factor, u in uniform.items())


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
