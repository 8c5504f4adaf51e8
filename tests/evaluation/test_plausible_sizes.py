"""Metres that are called millimetres are found, and small things that are right pass."""

import json

import numpy as np
import pytest

from glissando import PoseReadings, load_robot, se3
from glissando.evaluation.plausibility.examine import examine
from glissando.model.sensors.sensors import PositionReadings
from scenes import arc

ROBOT = load_robot("tdcr466")
TIME = np.arange(40) / 40.0


def positions(share, place=1.0, values=1.0, still=False):
    """Positions at a share of a robot's length as a file's numbers give them, times factors."""
    s = np.full(TIME.size, share * ROBOT.length)
    pose = arc(s, np.zeros(TIME.size) if still else TIME)
    seen = values * pose[:, :3, 3]
    return PositionReadings(
        time=TIME, arclength=place * s, values=seen, cov=np.full(3, 1e-6), name=f"at {share}"
    )


def found(*readings):
    return {f.name: f for f in examine(ROBOT, readings)}


@pytest.mark.parametrize(("place", "refusal"), [(1.0, True), (1e-3, False)])
@pytest.mark.parametrize("shares", [[1.0], [0.5, 1.0]])
def test_metres_that_are_called_millimetres_are_found(shares, place, refusal):
    streams = [positions(share, place, 1e-3) for share in shares]
    finding = found(*streams)["length-unit"]
    assert (finding.refusal, finding.streams) == (refusal, tuple(r.name for r in streams))
    assert "probably in metres, read as millimetres; give metres" in finding.sentence


@pytest.mark.parametrize("share", [0.0, 0.002, 0.02, 0.1, 1.0])
def test_a_still_robot_and_sensors_near_its_base_pass(share):
    assert "length-unit" not in found(positions(share, still=True))


def test_a_warning_on_a_slides_scale_can_be_written_as_json():
    time = np.arange(200) / 40.0
    place = 0.35 + 0.1 * np.sin(2.0 * time)
    noise = se3.exp(1e-4 * np.random.default_rng(0).standard_normal((200, 6)))
    coil = PoseReadings(
        time=time,
        arclength=0.35 + (place - 0.35) / 1.4,
        values=arc(place, 0.0 * time) @ noise,
        cov=np.full(6, 1e-8),
        name="coil",
    )
    finding = found(coil)["slide"]
    assert json.loads(json.dumps(finding.as_json()))["refusal"] is False
