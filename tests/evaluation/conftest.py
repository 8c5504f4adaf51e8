"""A simulated session that the tests of the guard share."""

import pytest

from glissando.cli.main import main
from glissando.evaluation.run import chosen_streams
from glissando.io.recording_folder import load_recording


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("guard") / "right"
    options = ["--shape", "C", "--slide", "oscillate", "--cycles", "1", "--seed", "3"]
    assert main(["simulate", *options, "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def session(folder):
    """Robot, sensors, truth and frames of a simulated session."""
    recording = load_recording(folder)
    streams = chosen_streams(recording, recording.robot, recording.span(), None, None)[:2]
    return recording.robot, *streams, recording.frames
