"""A running estimate told to Rerun: to its viewer as it happens, or to a file it opens later."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.visualization.figures import _MM
from glissando.visualization.film.frames import _tube
from glissando.visualization.page.live import faces_between
from glissando.visualization.page.page import SIGMAS

_TUBE, _BODY, _COIL = (130, 160, 190, 90), (40, 40, 40), (230, 159, 0)


class Rerun:
    """The robot with its 95 % tube, its coil, and how sure it is over time, for Rerun.

    `target` is a file to write (`.rrd`), or the address of a viewer that runs
    (`rerun+http://127.0.0.1:9876/proxy`); `arclength` (N,) that of the points updates give. A
    context manager, used as `Live` is. Raises GlissandoError without rerun-sdk and for another
    target.
    """

    def __init__(self, arclength: ArrayLike, target: str) -> None:
        try:
            import rerun
        except ImportError as missing:
            raise GlissandoError(
                "Rerun is not installed: run pip install 'glissando[rerun]'."
            ) from missing
        self.arclength, self.address = np.asarray(arclength, dtype=float), target
        self._rr: Any = rerun
        self._stream: Any = rerun.RecordingStream("glissando")
        if target.startswith("rerun"):
            self._stream.connect_grpc(target)
        elif target.endswith(".rrd"):
            self._stream.save(target)
        else:
            raise GlissandoError(
                f"Rerun can be told at {target!r} neither as a file nor as a viewer; give a file "
                f"name that ends in .rrd, or rerun+http://HOST:PORT/proxy."
            )

    def update(
        self, time: float, centres: Array, frames: Array, cov: Array, coil: float | None = None
    ) -> None:
        """Tell a state: `centres` (N, 3), `frames` (N, 4, 4) and position `cov` (N, 3, 3).

        World frame, metres, seconds; `coil` is its arclength, None while it is not seen.
        """
        rr, say = self._rr, self._stream.log
        self._stream.set_time("time", duration=float(time))
        turn = frames[:, :3, :3]
        rings, _ = _tube(frames[None], (np.swapaxes(turn, -1, -2) @ cov @ turn)[None], SIGMAS)
        say(
            "robot/tube",
            rr.Mesh3D(
                vertex_positions=(rings[0] / _MM).reshape(-1, 3),
                triangle_indices=faces_between(*rings[0].shape[:2]),
                albedo_factor=_TUBE,
            ),
        )
        thick = 0.004 * float(np.ptp(self.arclength))
        say("robot/body", rr.LineStrips3D([centres], radii=thick, colors=_BODY))
        place = [] if coil is None else [[np.interp(coil, self.arclength, x) for x in centres.T]]
        say("robot/coil", rr.Points3D(np.reshape(place, (-1, 3)), radii=3.0 * thick, colors=_COIL))
        std = _MM * np.sqrt(np.einsum("nii->n", cov))
        for name, value in (("tip", std[-1]), ("worst", std.max())):
            say(f"std_mm/{name}", rr.Scalars(float(value)))

    def close(self) -> None:
        """Have everything written or sent."""
        self._stream.flush()
        self._stream.disconnect()

    def __enter__(self) -> Rerun:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()
