"""Film of a posterior: the robot in its 95 % tube, and its standard deviation along the body."""

from glissando.visualization.film.film import save_animation
from glissando.visualization.film.frames import Frames, frames_at

__all__ = ["Frames", "frames_at", "save_animation"]
