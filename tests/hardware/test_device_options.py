"""What a simulated device cannot be asked for ends in a sentence and exit code 2."""

import importlib

import pytest

SCENE = ["--scene", "nowhere.npz"]
MOCAP = [*SCENE, "--bodies", "tip=0.1", "--to"]


@pytest.mark.parametrize(
    ("device", "options", "sentence"),
    [
        ("aurora", [*SCENE, "--tcp", "99999"], "give 0 to 65535"),
        ("aurora", [*SCENE, "--tcp", "0", "--rate", "nan"], "give a finite one"),
        ("aurora", [*SCENE, "--tcp", "0", "--rate", "0"], "give a number above zero"),
        ("aurora", SCENE, "give --tcp PORT or --pty LINK"),
        ("vicon", [*MOCAP, "here"], "is no HOST:PORT"),
        ("vicon", [*MOCAP, "127.0.0.1:x"], "give 0 to 65535"),
        ("vicon", [*MOCAP, "127.0.0.1:9", "--seed", "-1"], "is not a seed"),
        ("servo", ["--lead", "0"], "give a number above zero"),
        ("servo", ["--clock", "inf"], "give a finite one"),
        ("servo", ["--ends", "0.06", "0"], "give ends that increase"),
        ("servo", ["--start", "7"], "cannot start at 7 m"),
        ("servo", ["--backlash", "-1"], "give 0 or more"),
        ("servo", ["--travel", "99999"], "is no HOST:PORT"),
        ("grbl", ["--limits", "nan", "1"], "give a finite one"),
        ("grbl", ["--start", "99"], "cannot start at 99 mm"),
    ],
)
def test_options_that_cannot_be_are_sentences(capsys, device, options, sentence):
    module = importlib.import_module(f"glissando.hardware.simulated_devices.{device}")
    try:
        status = module.main(options)
    except SystemExit as end:  # of argparse
        status = end.code
    assert status == 2
    assert sentence in capsys.readouterr().err
