"""Constants from data: of a rig, of a robot."""
