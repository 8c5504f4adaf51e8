"""Constants of a robot file and of a laboratory, learned from recordings."""
