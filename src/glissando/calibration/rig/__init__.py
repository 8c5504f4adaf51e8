"""Calibration of a rig from one session, with the joint covariance of all its constants.

The constants are delay and rate of the clocks of tracker and slide relative to motion capture's,
the tracker's frame, the coil's mount, and zero, lead and backlash that relate the coil's arclength
to the travel of the slide's encoder.
"""
