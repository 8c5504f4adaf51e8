"""Whatever fails on the line, at the servo or in the program, the stage stops and says why."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.hardware.drivers import Slide
from glissando.hardware.simulated_devices.dynamixel import Do, packed
from servo_world import World, together
from slide_world import STAGE, TICK, Fused, Interrupted, Meddled, home, moved_from_zero

# A line with faults.


def test_spoilt_answers_are_asked_for_again_and_counted():
    world = World("corrupt=0.05", "short=0.05", start=0.0)
    with together(world), Slide("w", replace(STAGE, watchdog=1.0)) as slide:
        slide.home_here(0.0)
        readings = slide.move(0.06)
    assert readings[-1].travel == pytest.approx(0.06, abs=TICK)
    assert slide.counts["corrupt"] > 5
    travels = [r.travel for r in readings]
    assert np.all(np.diff(travels) > -2 * TICK)


def test_homing_believes_no_single_answer(monkeypatch):
    """A false one, whose checksum fits by chance, would shift every goal of the day."""
    with together(World(start=0.03)), Slide("w", STAGE) as slide:
        state, heard = slide._servo.state, []

        def false_once(*, check_error=True):
            heard.append(state(check_error=check_error))
            return replace(heard[-1], position=6098) if len(heard) == 3 else heard[-1]

        monkeypatch.setattr(slide._servo, "state", false_once)
        with pytest.raises(DeviceError, match="stood at 6098 and then at"):
            slide.home_here(0.03)
        monkeypatch.undo()
        slide.home_here(0.03)
        assert slide.read().travel == pytest.approx(0.03, abs=TICK)


def test_a_late_answer_is_never_taken_for_a_new_one():
    """Late by more than the SDK waits: without care a reading would be 40 ms, 1 mm, too old."""
    world = World("late=0.2:0.04", start=0.0)
    with together(world), Slide("w", replace(STAGE, watchdog=1.0)) as slide:
        slide.home_here(0.0)
        readings = slide.move(0.06)
    time_, truth = np.array(world.travel).T
    off = [r.travel - np.interp(r.time, time_, truth) for r in readings]
    assert set(slide.counts) == {"missing"}  # late ones are waited for and thrown away
    assert slide.counts["missing"] > 5
    # The middle of an exchange of 34 ms at most is off by half of it.
    assert np.abs(off).max() < 0.024 * 0.018


def test_a_stale_answer_is_found_by_its_tick():
    world = World()
    with together(world):
        slide = home(world)
        read = packed(1, Do.READ, bytes([120, 0, 16, 0]))
        (old,) = world.servo.receive(read, world.now)
        world.passes(0.1)
        arrived = world.arrived
        answers = [b"", old]  # nothing when the line is cleared, then one from before
        world.arrived = lambda: answers.pop(0) if answers else arrived()
        slide.read()
    assert slide.counts["stale"] == 1


def test_loss_of_replies_ends_with_a_sentence_and_a_standstill():
    world = World("dead=120", start=0.0)
    with together(world):
        with pytest.raises(DeviceError, match="did not answer 4 times in a row at 57600 baud"):
            moved_from_zero(world)
        place = world.screw.travel
        assert 0.005 < place < 0.055
        world.passes(5.0)
    assert world.screw.travel == place
    assert world.servo.table["bus_watchdog"] == -1


def test_a_servo_that_hears_but_is_not_heard_is_switched_off_soon():
    world = World("silent=120:9999", start=0.0)
    with together(world):
        with pytest.raises(DeviceError, match="did not answer"):
            moved_from_zero(world)
        world.passes(5.0)
    assert not world.servo.table["torque_enable"]
    lost = next(t for t, number in world.answers if number > 120)
    moved = [t for (t, a), (_, b) in pairwise(world.travel) if a != b]
    assert moved[-1] - lost < 0.3  # four attempts, and off


def test_a_torque_that_somebody_else_took_makes_the_place_doubtful():
    world = Meddled()
    with together(world):
        slide = home(world)
        world.meddles = world.heard
        with pytest.raises(DeviceError, match="has lost its torque"):
            slide.move(0.04)
        assert not slide.homed


def test_a_short_silence_is_survived():
    world = World("silent=120:2", start=0.0)
    with together(world), Slide("w", STAGE) as slide:
        slide.home_here(0.0)
        assert slide.move(0.06)[-1].travel == pytest.approx(0.06, abs=TICK)
    assert slide.counts == {"missing": 2}


def test_an_overload_is_told_in_words_and_a_reboot_and_home_mend_it():
    world = World("overload=120", start=0.0)
    with together(world):
        slide = home(world)
        with pytest.raises(DeviceError, match="it was overloaded; free the carriage"):
            slide.move(0.06)
        slide.reboot()
        assert not slide.homed
        with pytest.raises(DeviceError, match="does not know where it is"):
            slide.move(0.03)
        slide.home_here(world.screw.travel)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=TICK)


@pytest.mark.parametrize("at", [20, 60, 120, 200])
def test_a_loss_of_power_is_noticed_and_the_place_is_not_believed_any_more(at):
    world = World(f"restart={at}", start=0.01)
    with together(world):
        slide = home(world)
        with pytest.raises(DeviceError, match=r"lost power|lost its torque|did not answer"):
            _ = [slide.move(travel) for travel in (0.02, 0.05, 0.02, 0.05)]
        world.passes(1.0)
        with pytest.raises(DeviceError, match=r"lost power|does not know"):
            slide.read()
        slide.home_here(world.screw.travel)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=TICK)


def test_a_loop_that_dawdles_is_stopped_by_the_watchdog_and_told():
    world = World()
    with together(world):
        slide = home(world)
        path = slide.follow([0, 2], [0.03, 0.06])
        with pytest.raises(DeviceError, match=r"heard nothing for 0.2 s while it moved"):
            _ = [world.passes(0.5 if reading.travel > 0.04 else 0.0) for reading in path]
        assert world.screw.travel == pytest.approx(0.0415, abs=2e-3)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=TICK)


# Every way out stops the motion.


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("end", [RuntimeError, Interrupted, SystemExit, None])
def test_every_way_out_of_the_block_stops_the_motion(end, hold):
    world = World(start=0.0)
    with together(world):
        try:
            with Slide("w", replace(STAGE, hold=hold)) as slide:
                slide.home_here(0.0)
                for reading in slide.follow([0, 3], [0.0, 0.06]):
                    if reading.travel > 0.02:
                        if end is None:
                            break
                        raise end
        except (RuntimeError, Interrupted, SystemExit):
            pass
        place = world.screw.travel
        world.passes(3.0)
    assert world.screw.travel == pytest.approx(place, abs=TICK)
    assert place < 0.022
    assert world.servo.table["torque_enable"] == hold
    assert world.servo.table["bus_watchdog"] == 0


@pytest.mark.parametrize("way", ["break", "interrupt"])
def test_a_motion_that_is_broken_off_ends_there_while_the_block_goes_on(way):
    world = Fused(start=0.0)
    with together(world):
        slide = home(world)
        if way == "break":
            for reading in slide.follow([0, 3], [0.0, 0.06]):
                if reading.travel > 0.02:
                    break
        else:
            world.fuse = world.heard + 80
            with pytest.raises(Interrupted):
                slide.move(0.06)
        place = world.screw.travel
        world.passes(3.0)
        assert 0.0 < place < 0.05
        assert world.screw.travel == pytest.approx(place, abs=TICK)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=TICK)


@pytest.mark.parametrize("bytes_read", range(130, 170, 7))
def test_an_interrupt_inside_the_sdk_stops_the_motion(bytes_read):
    world = Fused(start=0.0)
    with together(world):
        world.fuse = bytes_read
        with pytest.raises(Interrupted):
            moved_from_zero(world)
        place = world.screw.travel
        world.passes(3.0)
    assert world.screw.travel == pytest.approx(place, abs=TICK)
    assert place < 0.055
    assert not world.servo.table["torque_enable"]
