"""Learning of a robot file's parameters, and calibration of mounts, from recordings."""
