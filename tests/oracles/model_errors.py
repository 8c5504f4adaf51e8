"""Model errors over time by dense algebra, and hits by shapes that are solved one by one."""

import numpy as np


def dense_covariance(problem, rows):
    """Covariances (K, n, n) before the readings of each of K corrections.

    All corrections are one vector, conditioned on all readings that come before at once.
    """
    count, size = len(rows), problem.time_scale.size
    kept = np.exp(-problem.space.correction / problem.time_scale)
    first = problem.belief.cov
    cov = np.zeros((count, count, size, size))
    own = first
    for k in range(count):
        for j in range(k, count):
            cov[k, j] = own * kept ** (j - k)
            cov[j, k] = cov[k, j].T
        own = kept[:, None] * own * kept + np.diag(1.0 - kept**2)
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


def sampled_errors(problem, known, count, rng):
    """What a filter and corrections leave of sampled model errors (count, q), moment after moment.

    The errors themselves are drawn, filtered, and corrected but for a part of what is known.
    """
    rows, before = known.corrections.rows, known.corrections.before
    size, own = problem.time_scale.size, problem.body.errors
    kept = np.exp(-problem.space.correction / problem.time_scale)
    moments = problem.space.moments / problem.space.correction
    true = rng.multivariate_normal(np.zeros(size), problem.belief.cov, count)
    known_of, left = np.zeros_like(true), problem.body.left.T
    off = true[:, :own]
    yield off
    for k in range(len(before) - 1):
        noise = rng.standard_normal((count, rows.shape[1]))
        gain = np.linalg.solve(
            np.eye(rows.shape[1]) + rows[k] @ before[k] @ rows[k].T, rows[k] @ before[k]
        ).T
        drift = np.sqrt(1.0 - kept**2) * rng.standard_normal((count, size))
        known_of = kept * (known_of + ((true - known_of) @ rows[k].T + noise) @ gain.T)
        true = kept * true + drift
        new = (true - known_of)[:, :own] + known_of[:, :own] @ left
        inside = moments[(moments > k + 1e-9) & (moments < k + 1 + 1e-9)]
        bridge = wandered(inside - k, kept[0], (count, own), rng)
        yield from (
            off + (moment - k) * (new - off) + b for moment, b in zip(inside, bridge, strict=True)
        )
        off = new


def wandered(share, kept, shape, rng):
    """A stationary process from 0 on, less what leads it to where it ends at a share of 1."""
    if kept == 1.0:
        return np.zeros((len(share), *shape))
    rate, path, before = -np.log(kept), [np.zeros(shape)], 0.0
    for part in [*share, 1.0]:
        fade = np.exp(-rate * (part - before))
        path.append(fade * path[-1] + np.sqrt(1.0 - fade**2) * rng.standard_normal(shape))
        before = part
    led = np.sinh(rate * np.asarray(share)) / np.sinh(rate)
    return np.array(path[1:-1]) - led[:, None, None] * path[-1]


def sampled_hits(problem, evaluation, count, rng):
    """Share of model errors with which a shape, solved anew, touches anything at any moment."""
    hit = np.zeros(count, dtype=bool)
    radius, std = problem.scene.robot_radius, problem.scene.model_std
    floor = std * rng.standard_normal((count, 1))
    for k, off in enumerate(sampled_errors(problem, evaluation.known, count, rng)):
        mean = problem.expected(problem.space.moments[k])
        values = np.broadcast_to(evaluation.values[k, :6], (count, 6))
        place = problem.body.shapes(values, mean + off).place.reshape(-1, 3)
        for obstacle in problem.scene.obstacles:
            clear = obstacle.distance(place)[0].reshape(count, -1) - radius
            hit |= np.any(clear + floor < 0.0, axis=1)
    return hit.mean()
