"""Numbers of a robot file, and mounts in a laboratory, learned from recordings."""
