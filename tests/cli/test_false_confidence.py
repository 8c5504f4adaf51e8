"""A robot file that is too sure of its robot is said to be, and a true one is not."""

import pytest

from glissando.cli.main import main

POSES = ",".join(f"pose:aurora{i}" for i in range(4))
CONTRADICTED, OUTSIDE = "The estimate contradicts its readings", "% of truth lies inside"


def warned(spacetime, tmp_path, capsys, recording, window, outline):
    """Whether readings, and truth, are said to be against the file of an outline."""
    file = tmp_path / "new.toml"
    assert main(["robot", "new", *outline.split(), "--out", str(file)]) == 0
    words = [str(spacetime / recording), "--robot", str(file), "--window", *window.split()]
    assert main(["estimate", *words]) == 0
    said = capsys.readouterr().err
    return CONTRADICTED in said, OUTSIDE in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("outline", "readings", "truth"),
    [
        ("--segments 3 --bend 90 --stretch 0.85", False, False),
        ("--segments 3 --bend 90 --stretch 0.05", True, True),
        ("--segments 1 --bend 180 --stretch 0.05", True, True),
    ],
)
def test_a_squeezed_robot(spacetime, tmp_path, capsys, outline, readings, truth):
    outline = f"--length 1.0 --diameter 0.02 --sensors {POSES} {outline}"
    found = warned(spacetime, tmp_path, capsys, "extensible", "0 1", outline)
    assert found == (readings, truth)


@pytest.mark.slow
@pytest.mark.parametrize(("bend", "truth"), [(180, False), (10, True)])
def test_a_robot_that_bends_more_than_its_file_says(spacetime, tmp_path, capsys, bend, truth):
    sensors = "pose:aurora0,pose:aurora1,gyro:gyro_mid,gyro:gyro_ee"
    outline = f"--length 0.466 --segments 2 --diameter 0.012 --bend {bend} --sensors {sensors}"
    found = warned(spacetime, tmp_path, capsys, "slow_free_space", "24 29", outline)
    assert found == (False, truth)


def test_sensors_without_a_stream_are_said_to_be_taken_as_mounted_right(tmp_path, capsys):
    outline = "--length 0.4 --segments 2 --diameter 0.012 --bend 180 --sensors pose,gyro"
    assert main(["robot", "new", *outline.split(), "--out", str(tmp_path / "r.toml")]) == 0
    assert "pose, gyro name no stream" in capsys.readouterr().err
