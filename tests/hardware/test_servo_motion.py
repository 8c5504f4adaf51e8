"""How the simulated servo moves: its profiles, its clock and watchdog, and the screw it turns."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import law
from glissando.hardware.simulated_devices.dynamixel import ALERT, Do, Fault, packed
from glissando.hardware.simulated_devices.profile import to
from glissando.hardware.simulated_devices.screw import Screw
from glissando.hardware.simulated_devices.xl430 import (
    ACCELERATION_UNIT,
    OVERLOAD,
    SPEED_UNIT,
    Xl430,
)  # fmt: skip
from servo_host import Host, words

sizes = st.floats(1.0, 1e4)
signed = st.floats(-1e4, 1e4)


@law
@given(signed, signed, sizes, sizes)
def test_profiles_end_at_rest_at_their_goal_within_their_limits(start, goal, top, sharp):
    profile = to(2.0, start, goal, speed=top, acceleration=sharp)
    time = 2.0 + np.linspace(0.0, profile.duration, 2001)
    place, speed = np.array([profile.at(t) for t in time]).T
    assert profile.at(time[-1] + 1.0) == (pytest.approx(goal, abs=1e-6), 0.0)
    assert np.abs(speed).max() <= top * (1 + 1e-9)
    step = time[1] - time[0]
    assert np.abs(np.diff(speed)).max() <= sharp * step * (1 + 1e-6) + 1e-6
    assert np.allclose(np.diff(place), 0.5 * step * (speed[1:] + speed[:-1]), atol=sharp * step**2)


@law
@given(st.floats(0.5, 60.0), st.integers(1, 265), st.integers(1, 500))
def test_a_trapezoid_lasts_as_long_as_its_closed_form(turns, velocity, acceleration):
    top, sharp = SPEED_UNIT * velocity, ACCELERATION_UNIT * acceleration
    way = 4096.0 * turns
    reached = min(top, np.sqrt(way * sharp))
    profile = to(0.0, 0.0, way, speed=top, acceleration=sharp)
    assert profile.duration == pytest.approx(way / reached + reached / sharp, rel=1e-9)
    t1 = 0.064 * velocity / acceleration  # s, the manual's time of acceleration
    if reached == top:
        assert profile.at(t1)[1] == pytest.approx(top, rel=2e-3)


def test_without_acceleration_a_profile_is_a_rectangle():
    profile = to(0.0, 0.0, 10.0, speed=2.0, acceleration=0.0)
    assert [profile.at(t) for t in (0.0, 2.5, 5.0)] == [(0, 2), (5, 2), (10, 0)]


def test_a_goal_is_reached_in_the_time_of_its_registers():
    host = Host().extended(velocity=248, acceleration=66)
    start = host.read(132, 4)
    host.write(116, start + 9676, 4)  # 60 mm of a 25.4 mm lead
    begun = host.now
    while host.read(122, 1) or host.read(128, 4) or host.now == begun:
        host.now += 0.001
    assert host.now - begun == pytest.approx(2.5 + 0.24, abs=0.01)
    assert abs(host.read(132, 4) - start - 9676) <= 1


def test_a_profile_velocity_of_zero_is_as_fast_as_the_motor_can():
    host = Host().extended()
    host.write(116, 4096, 4)
    host.now += 0.5
    assert host.read(128, 4) == 265


def test_a_restart_loses_the_turns_but_not_the_angle():
    host = Host(Xl430(Screw(ends=(-1.0, 1.0)))).extended()
    host.write(116, 10_000, 4)
    host.now += 5.0
    assert host.read(132, 4) == 10_000
    assert host.ask(Do.REBOOT)[0] == 0
    assert host.send(packed(1, Do.PING)) == []  # it takes a moment
    host.now += 1.0
    assert host.read(132, 4) == 10_000 % 4096
    assert (host.read(64, 1), host.read(11, 1), host.read(120, 2)) == (0, 4, 1000)


def test_the_servo_ticks_milliseconds_and_wraps():
    host = Host(Xl430(now=1.0, tick=32_000))
    assert host.read(120, 2) == 32_000
    host.now += 0.7675
    assert host.read(120, 2) == 32_767
    host.now += 0.001
    assert host.read(120, 2) == 0


def test_silence_longer_than_the_watchdog_stops_the_motion():
    host = Host().extended(velocity=100)
    assert host.write(98, 10, 1) == 0  # 200 ms
    host.write(116, 9000, 4)
    for _ in range(10):
        host.now += 0.19
        assert host.read(128, 4) == 100
    host.now += 0.21
    place = host.read(132, 4)
    host.now += 5.0
    assert (host.read(132, 4), host.read(98, 1)) == (place, 255)
    assert host.write(116, 9000, 4) == Fault.RANGE
    assert host.write(98, 0, 1) == 0
    assert host.write(116, place + 100, 4) == 0


def pressed(host):
    """The host, 20 s after a goal far beyond the hard end."""
    host.write(116, 100_000, 4)
    for _ in range(2000):
        host.now += 0.01
        host.servo.advance(host.now)
    return host


def test_an_overload_takes_the_torque_and_only_a_restart_gives_it_back():
    host = pressed(Host().extended(velocity=100))
    assert host.servo.screw.travel == pytest.approx(0.062)
    error, data = host.ask(Do.READ, words((70, 2), (1, 2)))
    assert (error, data) == (ALERT, bytes([OVERLOAD]))
    assert host.read(64, 1) == 0
    assert host.write(64, 1, 1) == ALERT | Fault.RESULT
    host.ask(Do.REBOOT)
    host.now += 1.0
    assert host.write(64, 1, 1) == 0


def test_a_gentle_push_against_a_stop_is_no_overload():
    host = Host().extended(velocity=100)
    host.write(100, 200, 2)
    pressed(host)
    assert host.read(70, 1) == 0
    assert host.read(126, 2) == 225  # a load of 200 / 885


@law
@given(
    st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=30),
    st.floats(0.0, 1e-3),
    st.sampled_from([1.0, -1.0]),
)
def test_the_carriage_follows_its_nut_within_the_play_and_never_moves_against_it(
    angles, play, direction
):
    screw = Screw(lead=0.0254, direction=direction, play=play, start=0.03)
    before_nut = before = 0.03
    for angle in angles:
        travel = screw.turn(angle)
        nut = 0.03 + direction * 0.0254 * angle / 4096.0
        assert abs(travel - nut) <= 0.5 * play + 1e-12
        assert (travel - before) * (nut - before_nut) >= 0.0
        before, before_nut = travel, nut


def test_there_and_back_loses_the_play():
    screw = Screw(play=1e-4, start=0.0)
    away = screw.turn(4096.0)
    assert screw.turn(4096.0 - 4096.0 * 1e-4 / 0.0254) == pytest.approx(away)
    assert screw.turn(0.0) == pytest.approx(0.5e-4)
