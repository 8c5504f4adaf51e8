"""Calibration of a rig from one session, with the joint covariance of all its constants.

Clocks of tracker and slide relative to motion capture's, the tracker's frame, the coil's mount, and
the coil's arclength for what the slide's encoder says.
"""
