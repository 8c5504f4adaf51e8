"""SE(3) on arrays: exponential, logarithm, adjoints, Jacobians."""
