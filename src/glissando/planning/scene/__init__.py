"""Motions among obstacles: joint plans of a tendon robot and its sliding sensors at a stated risk.

The response to tendons is uncertain: displacements differ from the commands, and the model lacks
bending moments. Readings of sliding sensors reduce this uncertainty, depending on their places.
Where the robot may pass thus depends on where its sensors are, so both are planned jointly.
"""
