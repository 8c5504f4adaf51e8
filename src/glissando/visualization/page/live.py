"""Live view of a running estimate in a browser: a small server that shows the newest state."""

from __future__ import annotations

import time as clock
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import GlissandoError, needing
from glissando.estimation.confidence_tube import SIGMAS_95, confidence_tube, tube_faces
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.geometry.se3 import Array
from glissando.visualization.canvas import MM
from glissando.visualization.page.scene import Scene

_TUBE, _COIL = (130, 160, 190), (230, 159, 0)


class Live:
    """A server that shows the robot with its 95 % tube to any browser on this machine.

    A context manager, which stops the server on exit.

    Args:
        arclength: Arclengths (N,) of the points in updates, m.
        top: Standard deviation of position at the end of the colour scale, m.
        port: Port of the server; 0 for any free one.

    Raises:
        GlissandoError: viser is not installed, or the port is out of range.
    """

    def __init__(self, arclength: ArrayLike, *, top: float = 0.02, port: int = 8080) -> None:
        if not 0 <= port < 1 << 16:
            raise GlissandoError(f"A port of {port} cannot be; give 0 to 65535.")
        with needing("A live view needs viser and matplotlib", "view"):
            import viser
            from matplotlib import colormaps
        self.arclength, self.top = np.asarray(arclength, dtype=float), top
        shades = colormaps["viridis"](np.linspace(0.0, 1.0, 256))[:, :3]
        self._shades = (255 * shades).astype(np.uint8)
        self._long = float(np.ptp(self.arclength))
        self._server: Any = viser.ViserServer(
            host="127.0.0.1", port=port, label="glissando", verbose=False
        )
        self._server.scene.set_up_direction("+z")
        self._server.scene.add_frame(
            "/world", axes_length=0.1 * self._long, axes_radius=0.003 * self._long
        )
        self._text = self._server.gui.add_markdown("Waiting for the first estimate.")
        self._server.gui.add_markdown(
            f"Tube: 95 %. Body: dark is sure, yellow ± {MM * top:.3g} mm or more."
        )
        self._look_at(np.zeros(3))  # until the first update, the camera looks at the base
        self._body: Any = None

    @property
    def address(self) -> str:
        """URL to open in a browser."""
        return f"http://127.0.0.1:{self._server.get_port()}"

    def update(
        self, time: float, centres: Array, frames: Array, cov: Array, coil: float | None = None
    ) -> None:
        """Show a state in the world frame, in milliseconds and without waiting for a browser.

        Args:
            time: Time of the state, s.
            centres: Positions (N, 3), m.
            frames: Poses (N, 4, 4).
            cov: Covariances of the positions (N, 3, 3), m².
            coil: Arclength of the coil, m; None if it has no current reading.

        Raises:
            GlissandoError: An array has the wrong shape.
        """
        self._require(centres, frames, cov)
        std = np.sqrt(np.einsum("nii->n", cov))
        turn = frames[:, :3, :3]
        rings, _ = confidence_tube(frames, np.swapaxes(turn, -1, -2) @ cov @ turn, SIGMAS_95)
        shade = self._shades[np.minimum(255 * std / self.top, 255).astype(int)]
        if self._body is None:
            self._look_at(centres.mean(axis=0))
            self._add(rings.shape[:2])
        with self._server.atomic():
            self._tube.vertices = rings.reshape(-1, 3).astype(np.float32)
            self._body.points = np.stack([centres[:-1], centres[1:]], 1).astype(np.float32)
            self._body.colors = np.stack([shade[:-1], shade[1:]], axis=1)
            place = np.nan if coil is None else coil
            self._coil.visible = bool(np.isfinite(place))
            if np.isfinite(place):
                self._coil.position = [np.interp(place, self.arclength, c) for c in centres.T]
        where = f", coil at {MM * place:.0f} mm" if np.isfinite(place) else ""
        self._text.content = (
            f"**{time:.2f} s**: tip ± {MM * std[-1]:.1f} mm, least sure ± "
            f"{MM * std.max():.1f} mm{where}"
        )

    def _require(self, centres: Array, frames: Array, cov: Array) -> None:
        count = self.arclength.size
        wanted = (count, 3), (count, 4, 4), (count, 3, 3)
        given = tuple(np.shape(a) for a in (centres, frames, cov))
        if given != wanted:
            raise GlissandoError(
                f"An update of shapes {given} does not fit {count} arclengths; give {wanted}."
            )

    def _look_at(self, centre: Array) -> None:
        camera = self._server.initial_camera
        camera.look_at = centre
        camera.position = centre + self._long * np.array([0.6, -0.75, 0.35])

    def _add(self, rings: tuple[int, int]) -> None:
        """Add the objects that updates move to the scene."""
        scene, count = self._server.scene, self.arclength.size
        faces = tube_faces(*rings)
        flat = np.zeros((rings[0] * rings[1], 3), dtype=np.float32)
        look = {"color": _TUBE, "opacity": 0.3, "side": "double", "cast_shadow": False}
        self._tube = scene.add_mesh_simple("/tube", flat, faces.astype(np.uint32), **look)
        ends = np.zeros((count - 1, 2, 3), dtype=np.float32)
        colours = np.zeros(ends.shape, dtype=np.uint8)
        self._body = scene.add_line_segments("/body", ends, colours, thickness=0.01 * self._long)
        self._coil = scene.add_icosphere("/coil", 0.012 * self._long, color=_COIL)

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def play(scene: Scene, port: int) -> None:
    """Show a scene repeatedly in real time until interrupted."""
    std, cov = np.linalg.norm(scene.root, axis=(-2, -1)), scene.root @ scene.root
    pause = max(np.diff(scene.time).mean(), 0.02) if scene.time.size > 1 else 0.5
    with Live(scene.arclength, top=float(np.quantile(std, 0.99)), port=port) as shown:
        print(f"Playing at {shown.address}; Ctrl-C ends it.", flush=True)
        for k in cycle(range(scene.time.size)):
            sensors = scene.place[k][np.isfinite(scene.place[k])]
            coil = float(sensors[0]) if sensors.size else None
            pose = scene.pose[k]
            shown.update(float(scene.time[k]), pose[:, :3, 3], pose, cov[k], coil)
            clock.sleep(pause)


def follow(view: Live, smoother: FixedLagSmoother) -> None:
    """Show the newest state of a smoother."""
    time = smoother.time or 0.0
    at = smoother.at(view.arclength, time)
    view.update(time, at.position, at.pose, at.cov_position_world)
