"""Model errors over time by dense algebra, and hits by shapes that are solved one by one."""

import numpy as np


def dense_covariance(problem, rows):
    """Covariances (K, q, q) before the readings of each moment, and lagged ones (K−1, q, q).

    All moments are one vector, conditioned on all readings that come before at once.
    """
    count, size = len(rows), problem.body.errors
    kept = problem.kept
    first, eye = problem.belief.cov, np.eye(size)
    cov = np.zeros((count, count, size, size))
    own = first
    for k in range(count):
        for j in range(k, count):
            cov[k, j] = kept ** (j - k) * own
            cov[j, k] = cov[k, j].T
        own = kept**2 * own + (1.0 - kept**2) * eye
    whole = cov.transpose(0, 2, 1, 3).reshape(count * size, -1)
    before = []
    for k in range(count):
        seen = np.zeros((k * rows.shape[1], count * size))
        for j in range(k):
            seen[j * rows.shape[1] : (j + 1) * rows.shape[1], j * size : (j + 1) * size] = rows[j]
        gain = whole @ seen.T @ np.linalg.inv(seen @ whole @ seen.T + np.eye(len(seen)))
        left = whole - gain @ seen @ whole
        before.append(left[k * size : (k + 1) * size, k * size : (k + 1) * size])
    return np.array(before)


def sampled_hits(problem, evaluation, count, rng):
    """Share of model errors with which a shape, solved anew, touches anything at any moment.

    Each sample is what a filter does not know: the true error less what it believes at the moment.
    """
    size, known = problem.body.errors, evaluation.known
    steps = len(known.before)
    true = rng.multivariate_normal(np.zeros(size), problem.belief.cov, count)
    off = true.copy()
    hit = np.zeros(count, dtype=bool)
    radius, std = problem.scene.robot_radius, problem.scene.model_std
    floor = std * rng.standard_normal((count, 1))
    for k in range(steps):
        mean = problem.kept**k * problem.belief.mean
        values = np.broadcast_to(evaluation.values[k, :6], (count, 6))
        place = problem.body.shapes(values, mean + off).place.reshape(-1, 3)
        for obstacle in problem.scene.obstacles:
            clear = obstacle.distance(place)[0].reshape(count, -1) - radius
            hit |= np.any(clear + floor < 0.0, axis=1)
        noise = rng.standard_normal((count, known.rows.shape[1]))
        gain = np.linalg.solve(
            np.eye(known.rows.shape[1]) + known.rows[k] @ known.before[k] @ known.rows[k].T,
            known.rows[k] @ known.before[k],
        ).T
        off = off - (off @ known.rows[k].T + noise) @ gain.T
        drift = np.sqrt(1.0 - problem.kept**2) * rng.standard_normal((count, size))
        off = problem.kept * off + drift
    return hit.mean()
