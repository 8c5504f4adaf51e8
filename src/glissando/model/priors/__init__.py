"""Gaussian priors over arclength and time: factors between nodes, and the state between them."""
