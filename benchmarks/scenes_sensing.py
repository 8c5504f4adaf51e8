"""Joint planning of slide and motion through two slits, for `scenes.py`.

The body ends in one slit about its middle and one about its tip. The sliding tracker reads
positions; the tendons' zeros are unknown and drift, so without readings the body is known to about
a centimetre. All policies have the same scene, risk, time and robots by seed.
"""

import sys
from dataclasses import dataclass, field, replace

import numpy as np

from glissando.errors import GlissandoError
from glissando.planning.scene.motion_search import Search
from glissando.planning.scene.motion_space import MotionSpace
from glissando.planning.scene.motion_starts import reach_target, slide_ways, starts
from glissando.planning.scene.obstacles import RoundedBox
from glissando.planning.scene.plan_motion import MotionPlan, improved, motion_problem, plan_motion
from glissando.planning.scene.sampled_risk import sample_risk
from glissando.planning.scene.scene import Actuator, Scene, Target
from glissando.planning.sliding_sensor import sliding_sensor
from scenes_world import PAUSE, WanderingWorld, followed

DELTA, HORIZON, RADIUS, TOLERANCE, MODEL_STD = 0.05, 10.0, 0.006, 0.005, 8e-4
GAPS = 2.8e-3, 4.2e-3  # m: clearance to each side, in the slits of middle and tip
BESIDE = 19e-3  # m: clearance from the slit of the middle at the start
FREE = 0.02  # m: distance from the start of the tip's slit to the tip
THICK = 0.01, 0.004  # m: half thickness
OUTER, WIDE, ROUNDING = 0.04, 0.03, 0.002
TENDON = {"speed": 2e-3, "acceleration": 1e-3, "start": 4.5e-3}
RESERVE = 0.75  # of their speed, for corrections
STROKE_RESERVE = 1e-3  # m, two standard deviations of their zeros
SPARE = 2e-3  # m: travel of tendons beyond the displacements at the target
SLIDE = {"speed": 0.04, "acceleration": 0.08}
REACH, BEGIN = (0.1, 1.0), 0.7  # of the length
FIXED = 0.65, 0.8, 0.95  # of the length
CANDIDATES, ITERATIONS = 2, 30
NEAR = 0.01  # m: distance within which a robot has reached the target


def drawn_passage(robot, seed):
    """Scene with two slits about the middle and the tip of a bent body."""
    rng = np.random.default_rng([seed, 3])
    slide = Actuator(REACH[0] * robot.length, REACH[1] * robot.length, **SLIDE,
                     start=BEGIN * robot.length)  # fmt: skip
    sensor = sliding_sensor(robot, "position", rate=10.0)
    side = rng.uniform(0.0, 2.0 * np.pi)
    bend = np.repeat(np.cumsum(rng.uniform([0.55, 0.05, 0.0], [0.65, 0.15, 0.1])), 3)
    start = TENDON["start"]
    pulled = start + robot.tendons.radius * bend * np.cos(robot.tendons.angle - side)
    tendons = [Actuator(min(start, p) - SPARE, max(start, p) + SPARE, **TENDON) for p in pulled]
    scene = Scene([], [Target(np.zeros(3), 1.0, HORIZON)], RADIUS, DELTA, HORIZON, tendons,
                  [slide], [sensor], model_std=MODEL_STD, correction=PAUSE,
                  reserve=RESERVE, stroke_reserve=STROKE_RESERVE)  # fmt: skip
    shape = motion_problem(scene, robot).body.shapes(pulled[None])
    across = np.array([-np.sin(side), np.cos(side), 0.0])
    obstacles = []
    places = rng.uniform(0.45, 0.55) * robot.length, robot.length - RADIUS
    for s, gap, thick in zip(places, GAPS, THICK, strict=True):
        pose = shape.pose_at(np.array([s]))[0, 0]
        place = pose[:3, 3] - (pose[:3, 3] @ across) * across
        tangent = pose[:3, 2] - (pose[:3, 2] @ across) * across
        tangent /= np.linalg.norm(tangent)
        away = np.linalg.norm(place[:2]) - RADIUS - BESIDE - thick * np.linalg.norm(tangent[:2])
        free = FREE if obstacles else away / tangent[2]
        obstacles += _slit(place, across, tangent, RADIUS + gap, free, thick)
    tip = shape.place[0, -1] - (shape.place[0, -1] @ across) * across
    return replace(scene, obstacles=obstacles, targets=[Target(tip, TOLERANCE, HORIZON)])


def _slit(place, across, normal, half, free, thick):
    """Two plates with a slit of half-width `half` between them."""
    along = np.cross(across, normal)
    size = np.array([0.5 * (free + OUTER), WIDE, thick])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([along, across, normal], axis=-1)
    plates = []
    for side in (-1.0, 1.0):
        at = pose.copy()
        at[:3, 3] = place + 0.5 * (OUTER - free) * along + side * (half + WIDE) * across
        plates.append(RoundedBox(at, size - ROUNDING, ROUNDING))
    return plates


@dataclass(frozen=True)
class GivenSpace(MotionSpace):
    """Motions with given control points (C, S+2) of some actuators; NaN for free actuators."""

    given: np.ndarray = field(kw_only=True)

    def control(self, free):
        """Control points of free parameters, with the given ones unchanged."""
        return np.where(np.isnan(self.given), super().control(free), self.given)

    def follow(self, target):
        """Control points near targets, with the given ones unchanged."""
        return np.where(np.isnan(self.given), super().follow(target), self.given)

    def free_gradient(self, by_value, by_control):
        """Gradient by the free parameters, zero for given actuators."""
        loose = np.isnan(self.given[:, :1])
        return super().free_gradient(by_value * loose[:, 0], by_control * loose)


def with_given(problem, rows, control):
    """Problem with the control points (C, S+2) of some rows given."""
    space, given = problem.space, np.full(control.shape, np.nan)
    given[rows] = control[rows]
    return replace(
        problem, space=GivenSpace(space.paths, space.moments, space.corrected, given=given)
    )


def searched(problem, warm=None):
    """Best motion found, even if it exceeds the allowed risk.

    The searches of all policies have the same initial guesses and iterations, and optionally a
    `warm` start. If no motion is within the risk, a further search minimises the risk.
    """
    try:
        return plan_motion(problem, candidates=CANDIDATES, iterations=ITERATIONS, warm_start=warm)
    except GlissandoError:
        search = Search(problem, 0.9 * problem.scene.delta)
        ways = starts(problem, reach_target(problem, 0)[None], 0, warm)
        at = search.at(min(ways, key=search.value))
        search, at = improved(search, at, ITERATIONS)
        return MotionPlan(search.problem, at, *sample_risk(search.problem, at), search.allowed)


def held(robot, scene, first, share):
    """Motion planned for a tracker fixed at a share of the length."""
    place, control = share * robot.length, first.copy()
    slide = Actuator(place - 5e-4, place + 5e-4, 1e-3, 1e-3, place)
    control[-1] = place
    return searched(motion_problem(replace(scene, slides=[slide]), robot), control)


def oscillating(robot, scene, first):
    """Motion planned for a tracker that oscillates over its range at its largest speed."""
    problem, control = motion_problem(scene, robot), first.copy()
    path = problem.space.paths[-1]
    reach = path.upper - path.lower
    turns = 0.5 * (path.speed * path.control_times + path.start - path.lower) / reach % 1.0
    control[-1] = path.follow(path.upper - np.abs(2.0 * turns - 1.0) * reach)
    return searched(with_given(problem, [-1], control), control)


def in_turn(robot, scene):
    """Motion planned for an exact model, and then the best path of the slide for it."""
    exact = replace(robot, tendons=replace(robot.tendons, std=1e-7, psd_moment=1e-14))
    blind = motion_problem(replace(scene, model_std=1.2e-3), exact, senses=False)
    control = plan_motion(blind, candidates=CANDIDATES, iterations=ITERATIONS).evaluation.control
    problem = with_given(motion_problem(scene, robot), range(len(control) - 1), control)
    search = Search(problem, 0.9 * DELTA)
    return searched(problem, min(slide_ways(problem, control), key=search.value))


def plans_of(robot, scene):
    """Yield name and plan of each policy."""
    joint = searched(motion_problem(scene, robot))
    first = joint.evaluation.control
    yield "slide and motion together", joint
    for share in FIXED:
        yield f"fixed at {share:g} of the length", held(robot, scene, first, share)
    yield "blind oscillation", oscillating(robot, scene, first)
    yield "motion first, slide after", in_turn(robot, scene)


def wide(plan):
    """Standard deviations (m) across the slits at middle and tip, at the end of the motion."""
    std = plan.evaluation.clearances.std()[:, -1]
    mean = plan.evaluation.clearances.mean[:, -1]
    nearest = np.argmin(mean / std, axis=1)
    return [float(std[k, nearest[k]]) for k in (0, 2)]


def scene_rows(robot, seed, runs):
    """Rows of each policy in a scene: its plan, and results of simulated robots."""
    rows = []
    for name, plan in plans_of(robot, drawn_passage(robot, seed)):
        kept = plan.risk <= DELTA + 2.0 * plan.risk_std and plan.miss <= TOLERANCE
        ended = np.array([followed(plan, robot, 1000 * seed + k, WanderingWorld)
                          for k in range(runs)])  # fmt: skip
        hit, near = ended[:, 0] < 0.0, ended[:, 1] < NEAR
        rows.append({"policy": name, "scene": seed, "planned": bool(kept), "risk": plan.risk,
                     "miss_mm": 1e3 * plan.miss, "std_mm": [1e3 * s for s in wide(plan)],
                     "runs": runs, "hits": int(hit.sum()), "reached": int(near.sum()),
                     "through": int((near & ~hit).sum())})  # fmt: skip
        print(f"  {rows[-1]}", file=sys.stderr, flush=True)
    return rows


def summed(rows, runs):
    """Row per policy, summed over scenes; scenes without a valid plan count as not passed."""
    out = []
    for name in dict.fromkeys(row["policy"] for row in rows):
        own = [row for row in rows if row["policy"] == name]
        middle, tip = np.mean([row["std_mm"] for row in own], axis=0)
        out.append({"policy": name, "scenes": len(own),
                    "planned": sum(row["planned"] for row in own),
                    "risk": float(np.mean([row["risk"] for row in own])),
                    "std_middle_mm": float(middle), "std_tip_mm": float(tip),
                    "runs": runs * len(own), "hits": sum(row["hits"] for row in own),
                    "through": sum(row["through"] for row in own),
                    "passed": sum(row["through"] for row in own if row["planned"])})  # fmt: skip
    return out


def draw_sensing(rows, runs, path):
    """Draw the standard deviations in both slits, and the share of robots that pass, by policy."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (known, passed) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    totals = summed(rows, runs)
    for k, total in enumerate(totals):
        own = np.array([row["std_mm"] for row in rows if row["policy"] == total["policy"]])
        known.loglog(*own.T, "o", color=f"C{k}", label=total["policy"])
        through, share = (100.0 * total[key] / total["runs"] for key in ("through", "passed"))
        passed.barh(k, through, color=f"C{k}", alpha=0.25)
        passed.barh(k, share, color=f"C{k}")
        passed.text(through + 1.0, k, f"{share:.0f} %", va="center")
    enough = 0.5e3 * np.array(GAPS)  # two standard deviations to each side
    known.plot([enough[0], enough[0], 0.1], [0.1, enough[1], enough[1]], "k--", lw=0.8)
    known.set(xlim=(1.0, 10.0), ylim=(1.0, 10.0), xlabel="std in the slit of the middle, mm",
              ylabel="std in the slit of the tip, mm")  # fmt: skip
    known.legend(fontsize=8)
    passed.set(
        xlim=(0.0, 118.0),
        xticks=range(0, 101, 25),
        xlabel="planned and passed (pale: not planned), %",
    )
    passed.set_yticks(range(len(totals)), [total["policy"] for total in totals])
    passed.invert_yaxis()
    figure.savefig(path, dpi=120)
    plt.close(figure)
