"""Pictures of a planned motion among obstacles: a figure, a film and an animated page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from glissando.estimation.confidence_tube import SIGMAS_95, confidence_tube, tube_faces
from glissando.geometry.covariance import symmetric_root
from glissando.geometry.se3 import Array
from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.obstacles import HalfSpace, sphere
from glissando.planning.scene.plan_motion import MotionPlan
from glissando.visualization.canvas import MM, canvas, gif_frames, gif_rate, line_colours
from glissando.visualization.page.scene import Scene as PageScene
from glissando.visualization.page.scene import Solid
from glissando.visualization.shape_figure import frame_axes

_SHOWN = 5  # shapes of a motion in one picture
_FRAMES = 60  # approximate number of frames of a film, unless it lasts for minutes
_ZOOM = 0.93  # of the view in space, so that labels have room
_INSET = 0.05, 0.14, 0.85, 0.84  # axes of a film: left, bottom, width, height
_OBSTACLE, _TARGET, _ZONE = "#8c8c8c", "#009E73", "#E69F00"


def scene_figure(plan: MotionPlan) -> Any:
    """Draw a planned motion in space with its 95 % tube, and its commands and clearance over time.

    The tube surrounds all points that the body may reach: its radius plus its uncertainty.

    Args:
        plan: The plan.

    Returns:
        The axes (4,): space, tendons, tip uncertainty with slides, clearance.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    plan = plan.evenly()
    with canvas(11.0, 6.0) as figure:
        grid = figure.add_gridspec(3, 2, width_ratios=[1.5, 1.0])
        space = figure.add_subplot(grid[:, 0], projection="3d", computed_zorder=False)
        panels = [figure.add_subplot(grid[row, 1]) for row in range(3)]
        _draw_space(space, plan, np.linspace(0, len(plan.evaluation.tip) - 1, _SHOWN), _ZOOM)
        _draw_time(panels, plan)
    return np.array([space, *panels], dtype=object)


def save_scene_film(plan: MotionPlan, file: Path) -> None:
    """Write a real-time GIF of a planned motion with its 95 % tube, obstacles and targets.

    Args:
        plan: The plan.
        file: The file to write.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    plan = plan.evenly()
    moments = plan.problem.space.moments
    lasts = float(np.ptp(moments))
    rate = gif_rate(_FRAMES / lasts)
    frames = np.linspace(0, moments.size - 1, max(2, round(rate * lasts)))
    with canvas(6.0, 5.4) as figure:
        figure.set_layout_engine("none")
        axes: Any = figure.add_axes(_INSET, projection="3d", computed_zorder=False)
        with gif_frames(figure, file, rate, dpi=80) as writer:
            for k in frames:
                axes.clear()
                _draw_space(axes, plan, np.array([k]))
                writer.grab_frame()


def _draw_space(axes: Any, plan: MotionPlan, moments: Array, zoom: float = 1.06) -> None:
    """Draw obstacles, targets, and the body at the moments with indices (K,)."""
    from matplotlib import colormaps
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    at, scene = plan.evaluation, plan.problem.scene
    axes.view_init(elev=18.0, azim=-60.0)
    for obstacle in scene.obstacles:
        vertices, faces = obstacle.surface()
        look = {"facecolor": _OBSTACLE, "alpha": 0.25, "linewidth": 0.0}
        axes.add_collection3d(Poly3DCollection(MM * vertices[faces], **look))
    for zone in scene.zones:
        if zone.center is not None:
            vertices, faces = sphere(zone.center, zone.radius).surface()
            look = {"facecolor": _ZONE, "alpha": 0.15, "linewidth": 0.0}
            axes.add_collection3d(Poly3DCollection(MM * vertices[faces], **look))
    for target in scene.targets:
        axes.plot(*(MM * target.position[:, None]), "*", color=_TARGET, ms=12, label="target")
    chosen = np.unique(moments.round().astype(int))
    for share, k in zip(np.linspace(0.0, 0.85, chosen.size), chosen, strict=True):
        colour = colormaps["viridis"](share)
        tube = MM * _reachable_surface(plan, k)
        axes.add_collection3d(Poly3DCollection(tube, facecolor=colour, alpha=0.15, linewidth=0.0))
        time = plan.problem.space.moments[k]
        axes.plot(*(MM * at.shapes.place[k].T), color=colour, lw=2.2, label=f"{time:.1f} s")
        _draw_zones(axes, plan, k)
    axes.plot(*(MM * at.tip.T), color="0.3", lw=0.8, ls=":")
    shown = [at.shapes.place.reshape(-1, 3), *(target.position[None] for target in scene.targets)]
    shown += [o.surface()[0] for o in scene.obstacles if not isinstance(o, HalfSpace)]
    frame_axes(axes, MM * np.concatenate(shown), zoom)
    axes.legend(loc="upper left", fontsize=9)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")


def _draw_zones(axes: Any, plan: MotionPlan, k: int) -> None:
    """Draw the parts of the body that lie in zones of interest at moment k."""
    body, place = plan.problem.body, plan.evaluation.shapes.place[k]
    for zone in plan.problem.scene.zones:
        if zone.center is not None:
            inside = np.linalg.norm(place - zone.center, axis=-1) <= zone.radius
        else:
            low, high = zone.arclength or (0.0, 0.0)
            inside = (body.arclength >= low) & (body.arclength <= high)
        part = np.where(inside[:, None], place, np.nan)
        axes.plot(*(MM * part.T), color=_ZONE, lw=4.0, zorder=3.0)


def _reachable_surface(plan: MotionPlan, k: int) -> Array:
    """Triangles (F, 3, 3) of the 95 % surface of the body, radius included, at moment k, m."""
    at = plan.evaluation
    rings, of = confidence_tube(at.shapes.pose[k], _body_cov(at, k), SIGMAS_95)
    away = rings - at.shapes.place[k, of][:, None]
    size = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
    rings = rings + plan.problem.scene.robot_radius * away / size
    return np.asarray(rings.reshape(-1, 3)[tube_faces(*rings.shape[:2])])


def _draw_time(panels: list[Any], plan: MotionPlan) -> None:
    time, values = plan.commands()
    at, scene, moments = plan.evaluation, plan.problem.scene, plan.problem.space.moments
    count = len(scene.tendons)
    panels[0].plot(time, MM * values[:, :count], lw=1.2)
    panels[0].set_ylabel("tendons (mm)")
    tip = MM * np.sqrt(np.einsum("kii->k", at.cov[:, -1]))
    panels[1].plot(moments, tip, color="black", label="tip's standard deviation (mm)")
    if scene.slides:
        slides = panels[1].twinx()
        colours = line_colours(values.shape[1] - count)
        for slide, colour in zip(MM * values[:, count:].T, colours, strict=True):
            slides.plot(time, slide, color=colour)
        slides.set_ylabel("slide (mm)", color=colours[0])
    panels[1].set_ylabel("tip σ (mm)")
    if scene.obstacles:
        c = at.clearances
        mean = c.mean + plan.problem.wider
        worst = MM * mean.min(axis=(0, 2))
        low = MM * (mean - SIGMAS_95 * c.std()).min(axis=(0, 2))
        panels[2].plot(moments, worst, color="black", label="expected")
        panels[2].fill_between(moments, low, worst, color="0.8", label="to 2.8 σ")
        panels[2].axhline(0.0, color="#D55E00", lw=1.0)
        panels[2].margins(y=0.25)
        panels[2].legend(loc="upper right", fontsize=9, ncols=2)
    panels[2].set(xlabel="time (s)", ylabel="clearance (mm)")


def _body_cov(at: Evaluation, k: int) -> Any:
    turn = at.shapes.pose[k, :, :3, :3]
    return turn.mT @ at.cov[k] @ turn


def scene_page(plan: MotionPlan) -> PageScene:
    """Scene of a planned motion for `page`: robot, confidence, obstacles and targets."""
    plan = plan.evenly()
    at, scene = plan.evaluation, plan.problem.scene
    moments, count = plan.problem.space.moments, len(scene.tendons)
    solids = [Solid(*obstacle.surface(), _OBSTACLE) for obstacle in scene.obstacles]
    solids += [
        Solid(*sphere(target.position, target.tolerance).surface(), _TARGET, clear=True)
        for target in scene.targets
    ]
    solids += [
        Solid(*sphere(zone.center, zone.radius).surface(), _ZONE, clear=True)
        for zone in scene.zones
        if zone.center is not None
    ]
    frames = moments.size
    nothing = np.zeros((frames, 0))
    return PageScene(
        time=moments,
        arclength=plan.problem.body.arclength,
        pose=at.shapes.pose,
        root=symmetric_root(at.cov),
        sensors=[sensor.name for sensor in scene.sensors],
        place=at.values[:, count:],
        sites=[],
        site_place=nothing,
        truth=np.zeros((frames, 0, 4, 3)),
        miss=nothing,
        nees=nothing,
        solids=tuple(solids),
    )
