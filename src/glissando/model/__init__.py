"""What is believed of a robot before any reading: grid, state, priors, sensors, noise."""
