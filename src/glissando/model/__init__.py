"""The model of a robot before any reading: grid, state, priors, sensors and noise."""
