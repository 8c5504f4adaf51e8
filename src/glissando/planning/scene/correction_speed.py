"""How fast tendons are to be so that what is read in a motion is corrected in time.

From one correction to the next what is known of the model error changes by what was read, with the
covariance P⁻ − P⁺ of the filter. Displacements that keep the bends change by −B⁺ E times that, with
slopes B of the bends by displacements and E by the model error.
"""

from __future__ import annotations

import numpy as np

from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.motion_problem import MotionProblem

_LIKELY = 2.0  # standard deviations
_EASE = 1e-3  # of the largest slope of bends by displacements, below which none is corrected


def correction_speed(problem: MotionProblem, at: Evaluation) -> float:
    """Largest speed of a tendon's corrections, beside the plan's own, with 95 % each time, m/s.

    Args:
        problem: The problem.
        at: The motion.
    """
    corrected, known = problem.space.corrected, at.known.corrections
    balance, by_error = at.shapes.balance, at.shapes.strain_by_error
    count, moments = len(problem.scene.tendons), len(known.before)
    by_pull = balance.strain_by_displacement()[corrected, :, 3:5].reshape(moments, -1, count)
    by_error = by_error[corrected, :, 3:5].reshape(moments, by_pull.shape[1], -1)
    pulled = np.linalg.pinv(by_pull, rcond=_EASE) @ by_error
    learned = known.own(known.before - known.after)
    variance = np.einsum("ktq,kqp,ktp->kt", pulled, learned, pulled)
    return float(_LIKELY * np.sqrt(max(variance.max(), 0.0)) / problem.space.correction)
