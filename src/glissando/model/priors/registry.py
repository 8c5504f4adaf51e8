"""Registry of priors by the kind that robot files name.

A custom prior is a class that implements the `Prior` protocol; `register_prior` makes it available
to robot files and posteriors.
"""

from __future__ import annotations

from glissando.errors import GlissandoError
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.priors.separable import SeparablePrior
from glissando.model.priors.white_noise import WhiteNoisePrior

_PRIORS: dict[str, type[Prior]] = {
    prior.kind: prior for prior in (WhiteNoisePrior, SeparablePrior, MechanicalPrior)
}


class UnknownPriorError(GlissandoError):
    """No prior of the given kind is registered."""


def register_prior(prior: type[Prior]) -> type[Prior]:
    """Register a prior under its `kind`; a class decorator."""
    _PRIORS[prior.kind] = prior
    return prior


def prior_kinds() -> list[str]:
    """Kinds of prior that robot files may name."""
    return list(_PRIORS)


def prior_class(kind: str) -> type[Prior]:
    """Class of the priors of a kind.

    Raises:
        UnknownPriorError: No prior has that kind.
    """
    if kind not in _PRIORS:
        raise UnknownPriorError(
            f"{kind!r} is not a kind of prior; known: {', '.join(_PRIORS)}. Import the file that "
            f"declares another (--plugin FILE)."
        )
    return _PRIORS[kind]
