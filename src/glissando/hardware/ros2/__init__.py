"""ROS 2 topics as a source of readings and as a sink of updates."""
