"""The robot over time in a browser: as a self-contained page, or live while an estimator runs."""

from glissando.visualization.page.live import Live
from glissando.visualization.page.page import page, save_view, subtitle
from glissando.visualization.page.scene import Scene, scene_of

__all__ = ["Live", "Scene", "page", "save_view", "scene_of", "subtitle"]
