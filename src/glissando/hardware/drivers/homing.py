"""Homing by contact with a mechanical stop: gentle, repeated, and checked for agreement."""

from __future__ import annotations

from collections import deque
from time import monotonic, sleep

from glissando.errors import DeviceError
from glissando.hardware.drivers.dynamixel import Servo
from glissando.hardware.drivers.stage import Stage

_STALL = 0.3  # s at rest after which the carriage counts as stopped by an obstacle
_CRAWL = 0.1  # fraction of the commanded speed below which the carriage counts as at rest
_BACK = 2e-3  # m of retreat from the stop before the second contact
_AGREE = 2e-4  # m, tolerance between the two contacts
_PACE = 0.01  # s between readings


def touch(servo: Servo, stage: Stage, speed: float, pwm: float) -> int:
    """Position in ticks at which the carriage touches its mechanical stop.

    The carriage must be at rest while the load shows that it pushes, retreat on command, and come
    to rest again at the same position [inferred: thresholds are to be tried on the real stage].

    Args:
        servo: The servo, with torque on.
        stage: The stage that the servo moves.
        speed: Speed of approach, m/s.
        pwm: Fraction of the motor's voltage to which it is limited.

    Raises:
        DeviceError: No stop was found, the carriage is stuck, or the two contacts disagree.
    """
    assert stage.home is not None
    low, high = stage.stroke
    side = -1.0 if stage.home <= low else 1.0
    farthest = high if side < 0.0 else low
    reach = side * (1.1 * abs(farthest - stage.home) + _BACK)
    first = _press(servo, stage, reach, speed, pwm)
    back = first - round(stage.ticks(side * _BACK))
    _retreat(servo, stage, back, speed, pwm)
    second = _press(servo, stage, side * 2.0 * _BACK, speed, pwm)
    gap = abs(stage.travel(second - first))
    if gap > _AGREE:
        raise DeviceError(
            f"Two touches of the stop differ by {1e3 * gap:.2g} mm; tighten the stage, or try "
            f"another pwm or speed."
        )
    return second


def _press(servo: Servo, stage: Stage, distance: float, speed: float, pwm: float) -> int:
    """Move until the carriage is at rest although driven; returns its position in ticks."""
    start = servo.state().position
    goal = start + round(stage.ticks(distance))
    servo.aim(goal, speed=stage.speed_units(speed))
    trail: deque[tuple[float, int]] = deque()
    while True:
        state = servo.state()
        now, place = state.time, state.position
        trail.append((now, place))
        while len(trail) > 1 and now - trail[1][0] >= _STALL:
            trail.popleft()
        moved = abs(stage.travel(place - trail[0][1]))
        if now - trail[0][0] >= _STALL and moved < _CRAWL * speed * _STALL:
            break
        sleep(_PACE)
    load = abs(1e-3 * state.load)
    servo.aim(place, speed=stage.speed_units(speed))
    if abs(place - goal) < abs(stage.ticks(_AGREE)) or load < 0.5 * pwm:
        raise DeviceError(
            f"No stop was met: the carriage stands after {1e3 * stage.travel(place - start):.3g} "
            f"mm with a load of {100 * load:.0f} %. Check `home`, `direction` and `lead`."
        )
    return place


def _retreat(servo: Servo, stage: Stage, goal: int, speed: float, pwm: float) -> None:
    """Move away from the stop, which a carriage that is stuck cannot do."""
    servo.aim(goal, speed=stage.speed_units(speed))
    end = monotonic() + 2.0 * _BACK / speed + 1.0
    while abs(stage.travel(servo.state().position - goal)) > _AGREE:
        if monotonic() > end:
            raise DeviceError(
                f"The carriage stuck and does not come back with {100 * pwm:.0f} % of the motor's "
                f"voltage; give more `pwm`, and look for what holds it."
            )
        sleep(_PACE)
