"""Picture of an animation: static parts are drawn once, and moving parts over them.

Everything is drawn at twice the size and then reduced, which smooths edges.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.visualization.arrows import FORCE
from glissando.visualization.canvas import AXES, MARKERS, SENSORS, legend, shown_name
from glissando.visualization.film.frames import Frames
from glissando.visualization.shape_figure import frame_axes

if TYPE_CHECKING:
    from PIL.Image import Image

INCHES = np.array([9.0, 5.2])
_ELEVATION, _AZIMUTH = 20.0, -52.0  # degrees
_FINER = 2
_VEIL = 0.7  # opacity of the tube
_TRAIL = range(10, 0, -2)  # ages, in frames, of the earlier curves that are drawn faintly


class Stage:
    """A figure whose static parts are drawn once; `picture` draws the moving parts over them."""

    def __init__(self, figure: Any, frames: Frames, width: int, speed: float) -> None:
        from matplotlib import colormaps

        self.frames, self.canvas, self.colours = frames, figure.canvas, colormaps["viridis"]
        self.size = tuple(2 * max(1, round(0.5 * n)) for n in width * INCHES / INCHES[0])
        self.top = max(float(np.quantile(frames.std, 0.99)), 1e-9)  # of the colours
        self.moving: list[Any] = []
        names = list(dict.fromkeys(frames.sensors))
        edge = {"mec": "black", "mew": 1.2, "ls": "none", "clip_on": False}
        self.looks: list[dict[str, Any]] = [
            {"color": SENSORS[i % len(SENSORS)], "marker": MARKERS[i % len(MARKERS)], **edge}
            for i in map(names.index, frames.sensors)
        ]
        figure.set_dpi(_FINER * width / INCHES[0])
        left, right = figure.subfigures(1, 2, width_ratios=[1.25, 1.0])
        curve, strip = right.subplots(2, 1, height_ratios=[2.6, 1.0])
        self._set_space(left)
        self._set_curve(curve, f"{speed:.2g}× speed" if abs(speed - 1.0) > 0.02 else "")
        self._set_strip(strip)
        self._draw_legend(left)
        _fit(left, self.space)
        figure.canvas.draw()
        self.still = figure.canvas.copy_from_bbox(figure.bbox)

    def _add(self, artist: Any) -> Any:
        """Register a moving artist: drawn in each frame in the order added, outside the layout."""
        artist.set(animated=True, in_layout=False)
        self.moving.append(artist)
        return artist

    def _line(self, axes: Any, **look: Any) -> Any:
        return self._add(axes.plot(*[[]] * (3 if axes is self.space else 2), **look)[0])

    def _set_space(self, panel: Any) -> None:
        """Create the view in space: shadow, tube, backbone, truth, forces, base and sensors."""
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        f, view = self.frames, {"elev": _ELEVATION, "azim": _AZIMUTH, "proj_type": "ortho"}
        self.space = axes = panel.add_axes(
            (0.0, 0.0, 1.0, 1.0), projection="3d", computed_zorder=False, **view
        )
        shown = np.concatenate([a.reshape(-1, 3) for a in (f.tube, f.triad, f.point, f.force)])
        frame_axes(axes, shown[np.isfinite(shown).all(axis=1)])
        three = (axes.xaxis, axes.yaxis, axes.zaxis)
        spans = [np.ptp(axis.get_view_interval()) for axis in three]
        for axis, span, pad in zip(three, spans, (5, 5, 13), strict=True):
            axis.get_major_locator().set_params(nbins=max(2, round(4 * span / max(spans))))
            axis.labelpad = pad
        axes.tick_params(labelsize=10, pad=1)
        axes.tick_params(axis="z", pad=5)
        self.shadow = self._line(axes, color="0.84", lw=4.0, solid_capstyle="round")
        self.skin = Poly3DCollection(np.zeros((1, 4, 3)), linewidth=0.5)
        self._add(axes.add_collection3d(self.skin, autolim=False))
        self.spine = self._line(axes, color="0.1", lw=2.2, solid_capstyle="round")
        self.true = [self._line(axes, color=colour, lw=1.8) for colour in AXES.values()]
        self.points = self._line(axes, color="black", marker="o", ms=5, ls="none")
        self.force = self._line(axes, color=FORCE, lw=2.0)
        self.base = self._line(axes, color="black", marker="s", ms=9, ls="none")
        self.dots = [self._line(axes, **look, ms=13) for look in self.looks]

    def _set_curve(self, axes: Any, note: str) -> None:
        """Create the plot of uncertainty along the body, coloured as the tube is, and the clock."""
        from matplotlib.collections import LineCollection, PolyCollection

        ends = self.frames.arclength[[0, -1]]
        axes.set(xlim=ends + 0.02 * np.ptp(ends) * np.array([-1.0, 1.0]), xlabel="arclength (mm)")
        axes.set(ylim=(0.0, 1.08 * self.frames.std.max()), ylabel="standard deviation (mm)")
        axes.yaxis.get_major_locator().set_params(nbins=5, steps=[1, 2, 5, 10])
        axes.set_title(note, loc="left", color="0.45")
        self.clock = self._add(axes.set_title("0", loc="right", fontsize=14, fontweight="bold"))
        self.clock.set_in_layout(True)
        self.trail = self._add(axes.add_collection(LineCollection([], linewidth=1.2)))
        self.area = self._add(axes.add_collection(PolyCollection([], linewidth=0)))
        self.now = self._line(axes, color="0.1", lw=2.4)
        self.stems = [self._add(axes.axvline(c=look["color"], lw=2.2)) for look in self.looks]
        self.marks = [self._line(axes, **look, ms=11) for look in self.looks]

    def _set_strip(self, axes: Any) -> None:
        """Create the map of uncertainty over the whole motion, along which a cursor moves."""
        f, wide = self.frames, np.zeros(1)
        if f.time.size == 1:  # drawn 1 s wide
            wide = np.array([-0.5, 0.5])
        std, place = (
            np.broadcast_to(a, (len(f.time + wide), a.shape[1])) for a in (f.std, f.place)
        )
        look = {"vmin": 0.0, "vmax": self.top, "cmap": self.colours, "shading": "gouraud"}
        axes.pcolormesh(f.time + wide, f.arclength, std.T, **look)
        axes.plot(f.time + wide, place, color="white", lw=1.6)
        axes.set(xlabel="time (s)", ylabel="arclength (mm)")
        axes.margins(0.0)
        for axis, nbins in ((axes.xaxis, 6), (axes.yaxis, 3)):
            axis.get_major_locator().set_params(nbins=nbins, steps=[1, 2, 5, 10])
        self.cursor = self._add(axes.axvline(f.time[0], color="black", lw=2.4))
        self.pins = [self._line(axes, **look, ms=8) for look in self.looks]

    def _draw_legend(self, panel: Any) -> None:
        """Draw the legend above the view in space."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        named = zip(self.frames.sensors, self.looks, strict=True)
        entries: dict[str, Any] = {
            shown_name(label): Line2D([], [], ms=11, **look) for label, look in named
        }
        entries["95 % of positions"] = Patch(color=self.colours(0.5), alpha=0.6, linewidth=0)
        if self.frames.forces:
            entries[self.frames.forces] = Line2D([], [], color=FORCE, lw=2.0)
        if self.frames.triad.size:
            entries["truth: x, y, z"] = tuple(Line2D([], [], lw=2, c=c) for c in AXES.values())
        if self.frames.point.size:
            entries["truth"] = Line2D([], [], color="black", marker="o", ms=5, ls="none")
        place: dict[str, Any] = {
            "loc": "upper left",
            "bbox_to_anchor": (0.01, 1.0),
            "ncols": len(entries) if len(entries) < 5 else 3,
        }
        legend(panel, entries, **place, columnspacing=1.4, handletextpad=0.5, handlelength=1.8)

    def picture(self, k: int) -> Image:
        """Image of frame k."""
        from PIL import Image

        self._move_space(k)
        self._move_plots(k)
        self.canvas.restore_region(self.still)
        pixels = np.asarray(self.canvas.buffer_rgba())
        for artist in self.moving:
            behind = pixels.copy() if artist is self.skin else None
            artist.axes.draw_artist(artist)
            if behind is not None:  # the tube was drawn opaque, so its rear is hidden; now blend it
                veil = Image.blend(Image.fromarray(behind), Image.fromarray(pixels), _VEIL)
                np.copyto(pixels, np.asarray(veil))
        return Image.fromarray(pixels).convert("RGB").resize(self.size, Image.Resampling.BOX)

    def _move_space(self, k: int) -> None:
        f, line = self.frames, self.frames.line[k]
        faces, colour = self._faces(f.tube[k], f.shade[k])
        self.skin.set(verts=faces, facecolor=colour, edgecolor=colour)
        self.skin.do_3d_projection()
        self.spine.set_data_3d(*line.T)
        self.shadow.set_data_3d(*line[:, :2].T, np.full(len(line), self.space.get_zlim()[0]))
        self.base.set_data_3d(*line[:1].T)
        for i, true in enumerate(self.true, start=1):  # NaN separates two strokes
            strokes = f.triad[k][:, [0, i, 0]] * np.array([1.0, 1.0, np.nan])[:, None]
            true.set_data_3d(*strokes.reshape(-1, 3).T)
        self.points.set_data_3d(*f.point[k].T)
        self.force.set_data_3d(*f.force[k].T)
        for dot, place in zip(self.dots, f.dot[k], strict=True):
            dot.set_data_3d(*place[:, None])

    def _move_plots(self, k: int) -> None:
        f, s, std = self.frames, self.frames.arclength, self.frames.std[k]
        left, right = np.arange(s.size - 1), np.minimum(np.arange(s.size - 1) + 2, s.size - 1)
        corners = [(s[left], 0.0 * s[left]), (s[right], 0.0 * s[right])]
        corners += [(s[right], std[right]), (s[left], std[left])]  # overlapping, to avoid seams
        colour = self.colours(0.5 * (std[1:] + std[:-1]) / self.top)
        self.area.set(verts=np.moveaxis(np.array(corners), -1, 0), facecolor=colour)
        self.now.set_data(s, std)
        past = [b for b in _TRAIL if b <= k]
        self.trail.set_segments([np.stack([s, f.std[k - b]], -1) for b in past])
        self.trail.set_color([(0.0, 0.0, 0.0, 0.4 * (1.0 - b / 12)) for b in past])
        self.cursor.set_xdata([f.time[k]] * 2)
        self.clock.set_text(f"{f.time[k]:.1f} s")
        for i, (place, height) in enumerate(zip(f.place[k], f.dot_std[k], strict=True)):
            self.stems[i].set_xdata([place, place])
            self.marks[i].set_data([place], [height])
            self.pins[i].set_data([f.time[k]], [place])

    def _faces(self, tube: Array, shade: Array) -> tuple[Array, Array]:
        """Quads of the tube that face the viewer (Q, 4, 3), and their colours (Q, 4)."""
        ring = np.concatenate([tube, tube[:, :1]], axis=1)
        quad = np.stack([ring[:-1, :-1], ring[1:, :-1], ring[1:, 1:], ring[:-1, 1:]], axis=2)
        normal = np.cross(quad[:, :, 3] - quad[:, :, 1], quad[:, :, 2] - quad[:, :, 0])
        up, turn = np.radians([_ELEVATION, _AZIMUTH])
        eye = np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
        facing = normal @ eye / np.maximum(np.linalg.norm(normal, axis=-1), 1e-12)
        seen = facing > 0.0
        colour = self.colours(0.5 * (shade[1:] + shade[:-1]) / self.top)
        colour = np.broadcast_to(colour[:, None], (*seen.shape, 4))[seen]
        light = facing[seen][:, None] ** 2
        colour[:, :3] += (1.0 - colour[:, :3]) * (0.45 * light)
        return quad[seen], colour


def _fit(panel: Any, axes: Any) -> None:
    """Fit axes in space, with their labels, into the panel below its legend."""
    from matplotlib.transforms import Bbox
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    corners = np.meshgrid(axes.get_xlim(), axes.get_ylim(), axes.get_zlim())
    for _ in range(3):  # iterated, because labels keep their size
        panel.get_figure(root=True).draw_without_rendering()
        below = panel.transSubfigure.inverted().transform(panel.legends[0].get_window_extent())
        room = np.array([[0.02, 0.02], [0.98, below[0, 1] - 0.01]])
        flat = proj_transform(*(c.ravel() for c in corners), axes.get_proj())[:2]
        box = axes.transData.transform(np.stack(flat, axis=-1))
        labels = [axis.get_tightbbox() for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
        extent = Bbox.union([Bbox([box.min(axis=0), box.max(axis=0)]), *labels])
        ends = panel.transSubfigure.inverted().transform(extent.get_points())
        scale = np.min((room[1] - room[0]) / (ends[1] - ends[0]))
        place = axes.get_position(original=True).get_points()
        axes.set_position(Bbox((place - ends.mean(axis=0)) * scale + room.mean(axis=0)))
