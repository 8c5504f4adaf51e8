"""Sessions drawn from a robot's own prior: motions, sensor parameters, and simulated readings.

A motion is drawn on a grid finer than the estimator's, in terms of the errors of intervals, with
their weights at rest. A separable prior is Gaussian in these errors except for the weights; a
kinematic one is linearised about rest, so that only small motions are drawn exactly. Readings are
taken at nodes of the fine grid with their stated noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.priors.separable import SeparablePrior
from glissando.model.robot import Robot
from glissando.model.sensors.parameter_process import EstimatedParameters, ParameterValues
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import sensor_class, sensor_kinds
from glissando.model.state import State
from glissando.solver.square_root import RootInformation, root_information

_FINER = 4  # refinement of the estimator's grid; along the robot 2 if there were over _MOST nodes
_MOST = 33
_TRIED, _EXCESS = 5, 2.0  # trial motions; largest median ratio of their cost to its expectation
_NODES = 6  # time intervals of a session without a recording
_READINGS = 1  # readings of every sensor per time interval


@dataclass(frozen=True)
class Session:
    """One drawn session.

    Attributes:
        truth: States (K, N) of the motion at the nodes of the fine grid.
        parameters: Values (K, E) of the sensor parameters at the fine time nodes.
        readings: Simulated readings of each stream.
    """

    truth: State
    parameters: Array
    readings: list[Readings]


@dataclass(frozen=True)
class PriorPredictive:
    """Draws sessions from a robot's prior.

    Attributes:
        robot: The robot.
        grid: The estimator's grid.
        layout: Sensors with places, times and noise of their readings; the values are ignored.
        prior: Prior for drawing, the robot's prior adapted to the fine grid.
        fine: Grid on which motions are drawn.
        process: Sensor parameters that are drawn.
    """

    robot: Robot
    grid: Grid
    layout: Sequence[Readings]
    prior: Prior = field(init=False)
    fine: Grid = field(init=False)
    process: EstimatedParameters = field(init=False)
    _rest: State = field(init=False)
    _root: RootInformation = field(init=False)

    def __post_init__(self) -> None:
        """Factor the prior's information, once for all draws.

        Raises:
            GlissandoError: The prior leaves the base free, so that it is not a proper density.
        """
        prior = self.robot.prior
        if not prior.fixes_base:
            raise GlissandoError(
                f"{self.robot.name} has no [base], so its prior cannot be drawn from; add one."
            )
        n_count = self.grid.arclength.size
        along = _FINER if _FINER * (n_count - 1) < _MOST else 2
        fine = Grid(_finer(self.grid.arclength, along), _finer(self.grid.time, _FINER))
        if isinstance(prior, SeparablePrior):
            prior = prior.on(fine)
        rest = prior.rest_state(fine)
        factors = prior.factors(fine, rest, rest, slice(0, fine.time.size))
        names = {r.name for r in self.layout}
        parameters = [p for p in self.robot.sensor_parameters if names.intersection(p.streams)]
        object.__setattr__(self, "prior", prior)
        object.__setattr__(self, "fine", fine)
        object.__setattr__(self, "process", EstimatedParameters(fine, parameters))
        object.__setattr__(self, "_rest", rest)
        object.__setattr__(self, "_root", root_information(factors, fine.shape, rest.dof))

    def draw(self, rng: np.random.Generator) -> Session:
        """Draw a session: motion, sensor parameters and readings.

        Args:
            rng: Random number generator.
        """
        moved = self._draw_motion(rng)
        truth = State(moved.pose, moved.strain, moved.velocity)
        values = self._draw_parameters(rng)
        drawn = ParameterValues(self.process, values)
        readings = [self._read(stream, truth, drawn, rng) for stream in self.layout]
        return Session(truth, values, [r.inside(self.grid) for r in readings])

    def require_exact(self, rng: np.random.Generator) -> None:
        """Raise if the prior's linearisation does not hold for the motions drawn from it.

        Twice the cost of an exact draw is χ²-distributed with one degree of freedom per variable.

        Args:
            rng: Random number generator.

        Raises:
            GlissandoError: The cost of drawn motions is far larger than expected.
        """
        excess = float(np.median([self._excess(self._draw_motion(rng)) for _ in range(_TRIED)]))
        if excess < _EXCESS:
            return
        how = f"cost {excess:.3g} times what it allows" if excess < np.inf else "have no shape"
        raise GlissandoError(
            f"Motions drawn from the prior of {self.robot.name} {how}: they are drawn from its "
            f"linearisation about rest, which they leave too far for ranks to say anything. Draw "
            f"from a separable prior, as `glissando robot new` writes, or from smaller densities."
        )

    def _excess(self, moved: State) -> float:
        """Twice the prior's cost of a motion per variable; infinite if it cannot be computed."""
        every, cost = slice(0, self.fine.time.size), np.inf
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            factors = self.prior.factors(self.fine, moved, moved, every)
            cost = sum(batch.terms.cost(batch.terms.residual) for batch in factors)
        excess = 2.0 * float(cost) / moved.pose[..., 0, 0].size / moved.dof
        return excess if np.isfinite(excess) else np.inf

    def _draw_motion(self, rng: np.random.Generator) -> State:
        """Draw a motion at the fine nodes."""
        step = self._root.sample(rng).reshape(*self.fine.shape, -1)
        return self.prior.retract_strains(self.fine, self._rest, step)

    def _draw_parameters(self, rng: np.random.Generator) -> Array:
        """Draw values (K, E) of Ornstein-Uhlenbeck processes at the fine time nodes."""
        white = rng.standard_normal((self.fine.time.size, self.process.size))
        decay, std, _ = self.process.drift(white)
        values = white * std
        for k, fade in enumerate(decay):
            values[k + 1] += fade * values[k]
        return self.process.mean + values

    def _read(
        self, stream: Readings, truth: State, drawn: ParameterValues, rng: np.random.Generator
    ) -> Readings:
        """Simulate a stream's readings of the motion, at the fine nodes nearest to the layout's."""
        k, n = (
            np.abs(nodes[:, None] - at).argmin(axis=0)
            for nodes, at in (
                (self.fine.time, stream.time),
                (self.fine.arclength, stream.arclength),
            )
        )
        placed = stream.changed(time=self.fine.time[k], arclength=self.fine.arclength[n])
        mounted, parameters = placed, drawn.of(stream)
        for parameter, columns in parameters:
            if parameter.kind == "mount":
                mounted = parameter.shift(mounted, drawn.values[k, columns])
        at = truth.take((k, n))
        if np.any(stream.arclength_std):  # where a sliding sensor really was
            off = np.broadcast_to(stream.arclength_std, k.shape) * rng.standard_normal(k.size)
            at = replace(at, pose=at.pose @ se3.exp(off[:, None] * at.strain))
        read = mounted.changed(values=noisy_values(mounted, at, rng))
        read = read.changed(mount=placed.mount)
        for parameter, columns in parameters:
            if parameter.kind != "mount":  # the error is minus the correction
                read = parameter.shift(read, -drawn.values[k, columns])
        return read


def _finer(nodes: Array, times: int) -> Array:
    """Nodes refined by a factor `times`."""
    places = np.arange(times * (nodes.size - 1) + 1) / times
    return np.interp(places, np.arange(nodes.size), nodes)


def noisy_values(readings: Readings, at: State, rng: np.random.Generator) -> Array:
    """Simulate values (M, …) of sensors at states, with their stated noise.

    Values other than poses and rotations are predicted by the sensor's residual.

    Args:
        readings: The sensor; its values are replaced.
        at: States (M,) at the readings.
        rng: Random number generator.

    Raises:
        GlissandoError: Readings of this sensor cannot be drawn, see `require_drawn`.
    """
    require_drawn(readings)
    root = np.linalg.cholesky(
        np.broadcast_to(readings.cov, (len(readings), *readings.cov.shape[-2:]))
    )
    noise = (root @ rng.standard_normal((*root.shape[:2], 1)))[..., 0]
    if readings.value_shape == (4, 4):
        wobble = np.zeros((len(readings), 6))
        wobble[:, : noise.shape[1]] = -noise
        roll = np.zeros_like(wobble)
        if noise.shape[1] == 5:  # a coil, whose roll is unknown
            roll[:, 5] = rng.uniform(-np.pi, np.pi, len(readings))
        return at.pose @ readings.mount @ se3.exp(wobble) @ se3.exp(roll)
    if readings.value_shape == (3, 3):
        turn = se3.exp(np.concatenate([np.zeros_like(noise), -noise], axis=1))
        return (at.pose @ readings.mount @ turn)[:, :3, :3]
    return readings.values + readings.residual(at) - noise


def require_drawn(readings: Readings) -> None:
    """Raise for sensors whose readings cannot be drawn.

    Raises:
        GlissandoError: The sensor depends on acceleration or on the whole robot, or sits in a
            channel beside the backbone.
    """
    for cannot, what in (
        (readings.accelerates, "an accelerometer"),
        (readings.spans, "tendons"),
        (readings.channel is not None, "a sensor in a channel"),
    ):
        if cannot:
            raise GlissandoError(
                f"{readings.label}: readings of {what} are not drawn; leave its stream out."
            )


def session_layout(robot: Robot) -> tuple[Grid, list[Readings]]:
    """Layout of a short session of the robot's own sensors, if there is no recording.

    Every kind of sensor in the robot file reads at each time node: a coil while it slides over the
    last quarter of the body and back, others at the tip. Streams named by sensor parameters are
    spread evenly over the body, the last at the tip. Their kind is the one contained in their name,
    else a gyroscope if they have a bias, else the first tracker of the file.

    Args:
        robot: The robot.

    Returns:
        The estimator's grid, and readings with placeholder values.

    Raises:
        GlissandoError: The robot file names no sensor that can be simulated.
    """
    stop = _NODES / robot.time_rate
    grid = robot.grid(0.0, stop)
    time = np.linspace(0.0, stop, _READINGS * _NODES + 1)
    sensors = {kind: sensor_class(kind) for kind in robot.sensor_std}
    kinds = [k for k, sensor in sensors.items() if not (sensor.settings or sensor.accelerates)]
    named: dict[str, str] = {}
    for parameter in robot.sensor_parameters:
        named |= {s: _kind_of(s, parameter, kinds) for s in parameter.streams}
    named = {stream: kind for stream, kind in named.items() if kind}
    places = robot.length * (1.0 + np.arange(len(named))) / max(len(named), 1)
    layout = [
        _blank(robot, kind, name, time, np.full(time.size, s))
        for (name, kind), s in zip(named.items(), places, strict=True)
    ]
    for kind in kinds:
        if kind not in named.values():
            place = np.full(time.size, robot.length)
            if kind == "coil":
                place -= 0.25 * robot.length * np.sin(np.pi * time / stop) ** 2
            layout.append(_blank(robot, kind, kind, time, place))
    if not layout:
        raise GlissandoError(
            f"{robot.name} names no sensor that can be simulated; add [sensors.KIND] with its std, "
            f"or give a recording whose sensors to take."
        )
    return grid, layout


def _kind_of(stream: str, parameter: SensorParameter, kinds: Sequence[str]) -> str:
    """Kind of sensor by a stream's name, else by its parameter; empty if there is none."""
    for kind in sensor_kinds():
        if kind in stream:
            return kind if kind in kinds else ""
    if parameter.kind == "bias" and "gyro" in kinds:
        return "gyro"
    return next((k for k in kinds if sensor_class(k).tracker), "")


def _blank(robot: Robot, kind: str, name: str, time: Array, arclength: Array) -> Readings:
    """Readings of a kind with placeholder values."""
    cls = sensor_class(kind)
    shape = cls.value_shape or (cls.rows,)
    one = np.eye(shape[0]) if len(shape) == 2 else np.zeros(shape)
    values = np.broadcast_to(one, (time.size, *shape))
    cov = robot.sensor_std[kind] ** 2
    return replace(
        cls(time=time, arclength=arclength, values=values, cov=cov, name=name),
        loss=robot.sensor_loss.get(kind),
    )
