"""A simulated rig is estimated while its slide moves, also where a plan of its own leads."""

import time

import numpy as np
import pytest

from glissando.cli.main import main
from glissando.errors import DeviceError
from glissando.hardware.capture import Coil, Rig, simulated_rig
from glissando.hardware.drivers import GcodeStage
from glissando.hardware.live import LiveSession
from glissando.hardware.live.replanning import Replanning
from glissando.hardware.live.rig_source import RigSource
from glissando.hardware.simulated_devices import started
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot
from glissando.model.slide_path import SlideLimits, SlidePath
from glissando.planning import Zone
from waiting import until

ROBOT = load_robot("sliding700")
HELD = SlidePath.hold(0.0, 3600.0, SlideLimits(1.0, 1.0, 1.0))
ZONE = (0.645, 0.665)


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.filterwarnings("ignore::glissando.errors.PlanWarning")  # on a busy machine
@pytest.mark.parametrize("delay", [0.0, 1.0])
def test_a_replanned_slide_brings_its_coil_into_the_zone_within_the_stages_limits(delay, tmp_path):
    """Also where updates wait for readings, so that shapes are of a second before."""
    with simulated_rig() as rig:
        source = RigSource(rig, ROBOT, HELD, steered=True)
        replanning = Replanning(source, rig, ROBOT, [Zone(ZONE)])
        session = LiveSession(
            ROBOT, [source], [replanning], journal=tmp_path / "log", duration=60.0, delay=delay
        )
        with session:
            for update in session:
                places = [r.arclength[-1] for r in update.readings]
                if places and ZONE[0] < places[-1] < ZONE[1]:
                    break
        rows = load_recording(tmp_path / "log").streams["coil"].rows
        planned, _ = replanning.replanner.at(rows.time[-1])
    assert rows.arclength[0] == pytest.approx(0.7, abs=1e-3)
    assert ZONE[0] < rows.arclength[-1] < ZONE[1]
    assert abs(planned - rows.arclength[-1]) < 5e-3
    moved, passed = np.abs(np.diff(rows.arclength)), np.diff(rows.time)
    assert np.all(moved < 2e-3 + 1.2 * rig.stage.speed * passed)
    assert rows.arclength.min() > 0.7 - rig.stage.stroke[1] - 1e-3


@pytest.mark.slow
@pytest.mark.alone
def test_a_simulated_rig_is_estimated_while_its_slide_moves(tmp_path, capsys):
    log, newest = tmp_path / "log", tmp_path / "newest.csv"
    slide = ["--slide", "oscillate", "--cycles", "1", "--stroke", "0.02"]
    options = ["--journal", str(log), "--sink", f"csv:{newest}", "--points", "2"]
    assert main(["live", "--source", "simulate", *slide, *options]) == 0
    assert "updates" in capsys.readouterr().out
    rows = load_recording(log).streams["coil"].rows
    assert rows.arclength.max() == pytest.approx(0.70, abs=1e-3)
    assert rows.arclength.min() == pytest.approx(0.68, abs=1e-3)
    assert rows.time.size > 40
    table = np.loadtxt(newest, delimiter=",", skiprows=1)
    assert np.linalg.norm(table[1::2, 2:5], axis=1).min() > 0.3  # the tip of an S of 0.7 m


@pytest.mark.slow
def test_a_steered_slide_follows_the_newest_path_and_stands_at_its_end():
    stage = GcodeStage(stroke=(0.0, 0.06))
    with started("grbl") as address:
        rig = Rig("bench", "sliding700", slide=address, stage=stage, standing=0.0)
        source = RigSource(rig, ROBOT, HELD, steered=True)
        session = LiveSession(ROBOT, [source])
        with source:
            clock = session.clock

            def travel():
                source.read(clock)
                motion = source._frames._slides["/slide"].at(time.monotonic())
                return motion.travel if motion else 0.0

            until(lambda: travel() or source.counts["heard"])
            for goal in (0.008, 0.003):
                begin, way = clock.now() + 0.3, abs(goal - travel())
                times = np.array([begin, begin + way / 0.015])
                source.steer(times, np.array([travel(), goal]))
                until(lambda goal=goal: abs(travel() - goal) < 2e-4)


def test_a_zone_in_millimetres_is_refused():
    stage, coils = GcodeStage(stroke=(0.0, 0.06)), (Coil("coil", 0.7),)
    rig = Rig("bench", "sliding700", coils=coils, slide="tcp://1", stage=stage, standing=0.0)
    with pytest.raises(DeviceError, match=r"off sliding700 of 0.7 m; correct it \(in metres\)"):
        Replanning(RigSource(rig, ROBOT, HELD), rig, ROBOT, [Zone((645.0, 665.0))])


def test_a_rig_without_a_stage_is_not_replanned():
    rig = Rig("bench", "sliding700")
    with pytest.raises(DeviceError, match="no stage that moves a coil"):
        Replanning(RigSource(rig, ROBOT, HELD), rig, ROBOT, [Zone(ZONE)])
