"""The robot over time in a browser: a page that works without a network, or a running estimate."""

from glissando.view.live import Live
from glissando.view.page import page, save_view, subtitle
from glissando.view.rerun import Rerun
from glissando.view.scene import Scene, scene_of

__all__ = ["Live", "Rerun", "Scene", "page", "save_view", "scene_of", "subtitle"]
