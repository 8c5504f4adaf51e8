"""Sessions drawn from the separable prior, and how well an estimate of them is calibrated."""

import numpy as np
from scipy.stats import chi2

from glissando import CoilReadings, Grid, GyroReadings, PoseReadings, State, estimate
from glissando.evaluation.metrics import errors_against
from glissando.geometry import se3
from glissando.model.priors.separable import BaseVariance, SeparablePrior
from glissando.model.state import POSE, STRAIN, VELOCITY
from separable_drawn import draw_motion

LENGTH, FINE_S, DURATION, FINE_T = 0.5, 40, 1.0, 32
PSD = np.array([1e-4, 1e-4, 1e-4, 2.0, 2.0, 0.5])


BASE = BaseVariance(np.array([1e-6] * 3 + [1e-5] * 3), np.array([1e-5] * 3 + [2.0, 2.0, 0.1]))


TIME_SCALE = 1.0  # a step of time is √3 h/ℓ = 0.22


PRIOR = SeparablePrior(PSD, TIME_SCALE, BASE)


GRID = Grid(np.linspace(0.0, LENGTH, 5), np.linspace(0.0, DURATION, 9))


COIL_COV = np.array([1e-6] * 3 + [1e-4] * 2)


POSE_COV = np.array([4e-6] * 3 + [4e-4] * 3)


GYRO_COV = np.full(3, 1e-2)


# Rows of fine times and fine arclengths where each sensor reads.
ON_NODES = np.arange(0, FINE_T + 1, 4)


COIL = np.r_[ON_NODES, [6, 18, 27]], np.r_[40, 38, 36, 34, 32, 34, 36, 38, 40, [37, 33, 39]]


POSES = np.array([0, 8, 16, 24, 32, 13]), np.array([18, 18, 20, 22, 22, 20])


GYRO = np.r_[ON_NODES, ON_NODES[1::2]], np.r_[np.full(9, 40), np.full(4, 23)]


# Where errors are judged: on a node, between arclengths, between times, and in cells.
JUDGED = np.array([16, 32, 12, 16, 22, 14, 30, 2]), np.array([20, 40, 10, 25, 30, 23, 36, 14])


FIELDS = {"pose": POSE, "strain": STRAIN, "velocity": VELOCITY, "all": slice(0, 18)}


def place(rows):
    return {"time": rows[0] * DURATION / FINE_T, "arclength": rows[1] * LENGTH / FINE_S}


def draw(rng):
    """A motion drawn from the prior: a State of FINE_T + 1 times and FINE_S + 1 arclengths."""
    fine = np.linspace(0.0, LENGTH, FINE_S + 1), np.linspace(0.0, DURATION, FINE_T + 1)
    drawn = draw_motion(
        rng,
        *fine,
        psd=PSD,
        base_pose_var=BASE.pose,
        base_strain_var=BASE.strain,
        time_scale=TIME_SCALE,
        rest_strain=PRIOR.rest_strain,
    )
    return State(*drawn[:3])


def read(rng, truth, inflate):
    """Noisy readings of a motion: a coil that slides near the tip, poses, gyroscopes."""

    def noisy(cov, rows):
        return inflate * np.sqrt(cov) * rng.standard_normal((rows[0].size, cov.size))

    wobble = np.zeros((COIL[0].size, 6))
    wobble[:, :5] = noisy(COIL_COV, COIL)
    seen = truth.pose[COIL] @ se3.exp(wobble)
    coil = CoilReadings(**place(COIL), values=seen, cov=COIL_COV)
    seen = truth.pose[POSES] @ se3.exp(noisy(POSE_COV, POSES))
    pose = PoseReadings(**place(POSES), values=seen, cov=POSE_COV)
    seen = truth.velocity[GYRO][:, 3:] + noisy(GYRO_COV, GYRO)
    gyro = GyroReadings(**place(GYRO), values=seen, cov=GYRO_COV)
    return [coil, pose, gyro]


def normalised_errors(inflate, trials):
    """Squared normalised errors (trials, places) by field, and of position and rotation alone."""
    rng = np.random.default_rng(11)
    found = {name: [] for name in (*FIELDS, "position", "rotation")}
    where = place(JUDGED)
    order = np.argsort(where["time"], kind="stable")
    for _ in range(trials):
        truth = draw(rng)
        posterior = estimate(PRIOR, GRID, read(rng, truth, inflate))
        at = posterior.at(where["arclength"], where["time"])
        miss = truth.take(JUDGED).difference(State(at.pose, at.strain, at.velocity))
        for name, part in FIELDS.items():
            cov = at.cov[:, part, part]
            white = np.linalg.solve(cov, miss[:, part, None])[..., 0]
            found[name].append(np.einsum("mi,mi->m", miss[:, part], white))
        poses = PoseReadings(**where, values=truth.pose[JUDGED], cov=1e-14)
        errors = errors_against(posterior, poses)
        for name in ("position", "rotation"):
            sorted_back = np.empty(order.size)
            sorted_back[order] = getattr(errors, f"nees_{name}")
            found[name].append(sorted_back)
    return {name: np.array(each) for name, each in found.items()}


DOF_OF = {"all": 18, "position": 3, "rotation": 3}


def judge(found):
    """Whether mean errors over the trials lie in two-sided χ² bounds, false alarm 1e-4; by name."""
    where, verdicts = place(JUDGED), {}
    print("mean NEES per degree of freedom at s =", *(f"{s:.3f}" for s in where["arclength"]))
    print("                                   t =", *(f"{t:.3f}" for t in where["time"]))
    for name, each in found.items():
        dof, trials = DOF_OF.get(name, 6), len(each)
        low, high = chi2.ppf([0.5e-4, 1 - 0.5e-4], dof * trials) / dof / trials
        mean = each.mean(axis=0) / dof
        print(f"{name:>36} :", *(f"{m:5.3f}" for m in mean), f"in [{low:.3f}, {high:.3f}]")
        verdicts[name] = (low <= mean) & (mean <= high)
    return verdicts
