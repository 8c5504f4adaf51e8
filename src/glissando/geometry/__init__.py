"""SE(3) on arrays: exponential, logarithm, adjoints, Jacobians."""

from glissando.geometry import se3 as se3
