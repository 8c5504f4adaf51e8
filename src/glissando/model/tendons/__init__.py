"""Tendons: the channels they run in, what they measure, and the shapes they pull a rod into."""
