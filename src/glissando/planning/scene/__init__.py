"""Motions among obstacles: a tendon robot and its sliding sensors planned as one, at a stated risk.

What tendons do is not known exactly: displacements differ from the commands and the model lacks
moments. Readings of sliding sensors tell of it, the more the better they are placed, so where the
robot may pass depends on where its sensors are, and both are chosen together.
"""
