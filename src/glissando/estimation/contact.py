"""Detection of contacts: a scan of a posterior for a single force along the robot.

Source: equation (29).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from glissando.errors import GlissandoError
from glissando.estimation.contact_evidence import (
    RAREST,
    ForceEvidence,
    error_priors,
    force_evidence,
    seen_times,
    shares_of_length,
)
from glissando.estimation.contact_force import force_at, knows_forces, nearest_nodes
from glissando.estimation.loads import require_mechanics
from glissando.estimation.posterior import Posterior
from glissando.estimation.transported import has_rolled
from glissando.geometry.se3 import Array
from glissando.model.grid import Index, points_of
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.quantiles import chi_square_quantile
from glissando.solver.block_tridiagonal import factor

_FEW = 0.01  # share of a node below which a force there is neglected
_SHARES = np.array([1.0, 1.0, 1.0 / 3.0])  # of a force across a robot and along it, by friction
_LIKELY = chi_square_quantile(0.95, 3)  # squared error of a force, in its covariance


@dataclass(frozen=True)
class ContactScan:
    """Evidence of a single force somewhere along the robot, at one time or at K times.

    Attributes:
        time: Times (…) of time nodes, s.
        arclength: Places (C,), m.
        log_ratio: Log ratio (…, C) of the evidence with a force there to that without: the map
            over arclength and time.
        force: Force (…, 3) in the body's axes at the likeliest place, N. From a single time, given
            that it acts there; from several, averaged over places, and NaN where the evidence is
            below the threshold or a window is too short to determine it.
        cov: Covariance (…, 3, 3) of the force.
        evidence: Log ratio (…) of the evidence with a force anywhere, equally likely at all places,
            to that without.
        threshold: Value that `evidence` exceeds in a share `false_alarms` of times without contact.
        false_alarms: Share of times without contact at which the threshold is exceeded.
        acts: Whether (…) readings of all times confirm a force; True where this was not computed.
    """

    time: Array
    arclength: Array
    log_ratio: Array
    force: Array
    cov: Array
    evidence: Array
    threshold: Array
    false_alarms: float
    acts: Array = field(default_factory=lambda: np.ones((), dtype=bool))

    @property
    def detected(self) -> Array:
        """Whether (…) a contact is detected.

        A contact that begins or ends suddenly raises the evidence at times before and after it as
        well; at those the readings of all times do not confirm a force.
        """
        return np.asarray(np.logical_and(self.evidence > self.threshold, self.acts))

    @property
    def best(self) -> Index:
        """Index (…) of the likeliest place."""
        return np.argmax(self.log_ratio, axis=-1)

    @property
    def shares(self) -> Array:
        """Probability (…, C) of each place, given that a force acts at one of them."""
        share = np.exp(self.log_ratio - np.max(self.log_ratio, axis=-1, keepdims=True))
        share *= shares_of_length(self.arclength)
        return np.asarray(share / np.sum(share, axis=-1, keepdims=True))

    @property
    def std_place(self) -> Array:
        """Standard deviation (…) of the place, m, given that a force acts at one of them."""
        share = self.shares
        mean = np.sum(share * self.arclength, axis=-1, keepdims=True)
        spacing = np.gradient(self.arclength) if self.arclength.size > 1 else np.zeros(1)
        square = (self.arclength - mean) ** 2 + spacing**2 / 12.0
        return np.asarray(np.sqrt(np.sum(share * square, axis=-1)))

    def without_force(self) -> ContactScan:
        """The scan with force and covariance NaN, for unknown."""
        return replace(self, force=np.full(3, np.nan), cov=np.full((3, 3), np.nan))

    @staticmethod
    def over(scans: Sequence[ContactScan]) -> ContactScan:
        """Join scans of K times at the same places, such as those of an online smoother.

        Raises:
            GlissandoError: There are no scans, or their places differ.
        """
        if len({scan.arclength.tobytes() for scan in scans}) != 1:
            raise GlissandoError("Give scans of one smoother, one at least: they share its places.")
        parts = {
            name: np.stack([getattr(scan, name) for scan in scans])
            for name in ("time", "log_ratio", "force", "cov", "evidence", "threshold", "acts")
        }
        places, rate = scans[0].arclength, scans[0].false_alarms
        return ContactScan(arclength=places, false_alarms=rate, **parts)


def scan_contacts(
    posterior: Posterior,
    time: ArrayLike,
    *,
    std_force: ArrayLike | None = None,
    false_alarms: float = 0.01,
) -> ContactScan:
    """Scan a posterior of a mechanical prior for one force, at the time nodes nearest to `time`.

    The force varies in time as the prior's loads do, which decay over its `time_scale`. Where one
    is likely at one of several times, its size is estimated from all readings, with a force that
    may act on the node nearest to that place at any time. The evidence is uninformative at time
    nodes beside which there are no readings.

    Args:
        posterior: The posterior, whose prior has no contact.
        time: Seconds: one time, or (K,) for a map over arclength and time.
        std_force: Prior standard deviation of a force, N: of each component (3,) in the body frame,
            or of all; if None `bending_force` across the robot, and a third of it along, as by
            friction.
        false_alarms: Share of times at which a contact may be reported without any.

    Raises:
        GlissandoError: The prior has no mechanics, the posterior's file is of an older version, or
            `std_force` or `false_alarms` is invalid.
        OutsideGridError: A time is off the grid.
    """
    prior, grid = require_mechanics(posterior.prior), posterior.grid
    _, when = points_of(0.0, time)
    if not when.size:
        raise GlissandoError("A scan for contacts needs a time; give one, or several.")
    grid.require(np.zeros(when.size), when.ravel(), "Contact")
    if posterior.linearized is None:
        raise GlissandoError(
            "This posterior's file lacks what a scan for contacts needs, as those of older "
            "versions do; estimate again from the recording."
        )
    rows = np.abs(when.reshape(-1, 1) - grid.time).argmin(axis=1)
    state, noise_state = posterior.linearized
    errors, marginals = error_priors(prior, grid, noise_state), posterior.marginals
    if has_rolled(state, posterior.state):
        marginals = factor(posterior.system).marginals(consume=True)
    cov = marginals.cov
    step = posterior.state.difference(state).reshape(grid.time.size, -1)
    variance, nodes = force_variance(prior, grid.arclength, std_force), grid.arclength
    seen, scans = seen_times(posterior), []
    for k in rows:
        evidence = force_evidence(prior, nodes, errors[k], state.take(k), cov[k], step[k])
        evidence = evidence if seen[k] else evidence.uninformative()
        scans.append(scan_of(evidence, errors[k].time, variance, false_alarms))
    if grid.time.size > 1:
        scans = with_forces(posterior, scans, rows, variance)
    return ContactScan.over(scans) if when.ndim else scans[0]


def with_forces(
    posterior: Posterior, scans: Sequence[ContactScan], rows: Index, variance: Array
) -> list[ContactScan]:
    """Scans of several times with the force at each, averaged over the places where it may act.

    Args:
        posterior: The posterior.
        scans: K scans.
        rows: Their time nodes (K,).
        variance: Prior variance (3,) of a force, N².
    """
    out = [scan.without_force() for scan in scans]
    likely = np.array([bool(scan.evidence > scan.threshold) for scan in scans])
    likely &= knows_forces(posterior)
    arclength = posterior.grid.arclength
    place = np.array([scan.arclength[scan.best] for scan in scans])
    best, shares = nearest_nodes(arclength, place), np.zeros((len(scans), arclength.size))
    for k in np.flatnonzero(likely).tolist():
        np.add.at(shares[k], nearest_nodes(arclength, scans[k].arclength), scans[k].shares)
        shares[k, best[k]] = max(shares[k, best[k]], _FEW)
    shares[shares < _FEW] = 0.0
    force, cov = np.zeros((*shares.shape, 3)), np.zeros((*shares.shape, 3, 3))
    for node in np.flatnonzero(shares.any(axis=0)).tolist():
        which = np.flatnonzero(shares[:, node])
        force[which, node], cov[which, node] = force_at(posterior, node, variance, rows[which])
    turns = posterior.at(place, posterior.grid.time[rows]).pose[:, :3, :3]
    for k in np.flatnonzero(likely).tolist():
        in_body = force[k] @ turns[k], turns[k].T @ cov[k] @ turns[k]
        acts = _acts(scans[k], *(each[best[k]] for each in in_body))
        mean, spread = mixed(shares[k], *in_body)
        out[k] = replace(scans[k], force=mean, cov=spread, acts=acts)
    return out


def mixed(shares: Array, mean: Array, cov: Array) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3, 3) of a mixture of C, with probabilities as `shares` (C,)."""
    shares = shares / np.sum(shares)
    whole = shares @ mean
    off = mean - whole
    spread = np.einsum("c,ci,cj->ij", shares, off, off)
    return whole, np.einsum("c,cij->ij", shares, cov) + spread


def _acts(scan: ContactScan, force: Array, cov: Array) -> Array:
    """Whether a force acts at the likeliest place, given its estimate (3,) from all times.

    None acts if that estimate is compatible with zero, and not with that of the single time.
    """
    is_zero, is_same = (
        off @ np.linalg.solve(cov, off) < _LIKELY for off in (force, force - scan.force)
    )
    return np.asarray(is_same or not is_zero)


def scan_of(
    evidence: ForceEvidence, time: float, variance: Array, false_alarms: float
) -> ContactScan:
    """Scan of one time, see `scan_contacts`.

    Args:
        evidence: Evidence of a force at each place.
        time: Seconds.
        variance: Prior variance (3,) of a force, N².
        false_alarms: Share of times at which a contact may be reported without any.
    """
    if np.asarray(false_alarms).dtype.kind not in "fi" or not RAREST <= false_alarms <= 0.5:
        raise GlissandoError(
            f"false_alarms is {false_alarms!r}; give a share of times from {RAREST:g} to 0.5."
        )
    cov, half_log_det = evidence.given_force(variance)
    force = np.einsum("cij,cj->ci", cov, evidence.vector)
    ratio = 0.5 * np.einsum("ci,ci->c", evidence.vector, force) - half_log_det
    best = int(np.argmax(ratio))
    total = np.asarray(logsumexp(ratio, b=evidence.shares))
    threshold = np.asarray(evidence.alarm_threshold(variance, false_alarms))
    when, places = np.asarray(time), evidence.arclength
    found = force[best], cov[best]
    return ContactScan(when, places, ratio, *found, total, threshold, false_alarms)


def bending_force(prior: MechanicalPrior, arclength: Array) -> float:
    """Force at the tip that would deflect the robot by its length if it bent linearly, N."""
    return 3.0 * float(prior.mechanics.stiffness[:, 3:5].mean()) / float(arclength[-1]) ** 2


def force_variance(prior: MechanicalPrior, arclength: Array, std: ArrayLike | None) -> Array:
    """Prior variance (3,) of a force, N², from std (3,) or (), N; by `bending_force` if None."""
    given = np.asarray(bending_force(prior, arclength) * _SHARES if std is None else std)
    sound = given.shape in ((), (3,)) and given.dtype.kind in "fiu"
    if not sound or not np.all((given > 0.0) & np.isfinite(given)):
        raise GlissandoError(f"std_force is {std!r}; give newtons above 0, one number or three.")
    return np.broadcast_to(given.astype(float), 3) ** 2
