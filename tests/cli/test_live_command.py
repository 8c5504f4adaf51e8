"""`glissando live` runs, says how it goes, and ends cleanly whatever ends it."""

import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

from glissando.cli import browser
from glissando.cli import live as command
from glissando.cli.main import main
from glissando.hardware.openigtlink import Endpoint
from glissando.io.recording_folder import load_recording, save_recording
from glissando.visualization.page import Live
from live_recordings import ROBOT, SPAN, pose_messages, swaying
from waiting import until


@pytest.fixture
def recording(tmp_path):
    save_recording(swaying(), tmp_path / "swaying", "tdcr466")
    return tmp_path / "swaying"


@pytest.mark.slow
def test_a_recording_runs_live_and_leaves_journal_and_csv(recording, tmp_path, capsys):
    log, newest = tmp_path / "log", tmp_path / "newest.csv"
    options = ["--source", str(recording), "--journal", str(log), "--sink", f"csv:{newest}"]
    assert main(["live", *options, "--duration", "0.5", "--points", "3"]) == 0
    said = capsys.readouterr()
    count = int(said.out.split()[0])
    assert 1 < count <= 16
    assert f"Journal: {log}." in said.out
    assert "Waiting for the first reading" in said.err
    assert np.loadtxt(newest, delimiter=",", skiprows=1).shape[0] == 3 * count
    assert set(load_recording(log).streams) == {"base", "tip"}


@pytest.mark.slow
def test_the_status_states_rate_latency_innovations_and_losses_beside_a_view(
    tmp_path, capsys, monkeypatch
):
    pytest.importorskip("viser", reason="viser is not installed")
    wrong = swaying()
    wrong.streams["tip"].rows.values[20, :3, 3] += 0.5
    save_recording(wrong, tmp_path / "wrong", "tdcr466")
    views = []

    def view(arclength):
        views.append(Live(arclength, port=0))
        return views[-1]

    monkeypatch.setattr(command, "_PLAIN", 0.1)
    monkeypatch.setattr(browser, "Live", view)
    options = ["--source", str(tmp_path / "wrong"), "--view"]
    assert main(["live", *options, "--rate", "20", "--duration", "1.2"]) == 0
    said = capsys.readouterr().err
    assert f"Look at {views[0].address}" in said
    line = re.findall(r"^.* s: tip ± .*$", said, re.M)[-1]
    figures = (
        r"([\d.]+) s: tip ± ([\d.]+) mm, ([\d.]+) Hz, latency ([\d.]+) ms, p99 ([\d.]+) ms, "
        r"innovations ([\d.]+), (.*)"
    )
    *numbers, losses = re.fullmatch(figures, line).groups()
    time, std, rate, latency, _, innovations = map(float, numbers)
    assert SPAN[0] < time <= SPAN[1]
    assert 0.0 < std < 50.0
    assert 0.0 < latency < 100.0
    assert rate == pytest.approx(20.0, rel=0.3)
    assert 0.0 <= innovations < 2.0
    assert "1 tip " in losses
    assert "Waiting" not in views[0]._text.content


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--source", "nowhere"], "There is no source 'nowhere'; give igtl"),
        (["--source", "simulate", "--robot", "tdcr466"], "is 0.466 m long and the robot of simul"),
        ([], "give --source"),
        (["--source", "igtl://:1"], "No source says which robot"),
        (["--robot", "tdcr466", "--source", "nowhere"], "no source 'nowhere'"),
        (["--robot", "tdcr466", "--source", "igtl://:1", "--sink", "x"], "no sink 'x'"),
        (["--robot", "tdcr466", "--source", "igtl://:1", "--at", "x"], "NAME=METRES"),
        (["--robot", "tdcr466", "--source", "igtl://:1", "--at", "a=466"], "in metres"),
        (["--robot", "tdcr466", "--source", "igtl://:1", "--patience", "0.3"], "nobody answers"),
        (["--robot", "tdcr466", "--source", "igtl://:1", "--rate", "0"], "A rate of 0 Hz"),
    ],
)
def test_what_is_wrong_is_one_sentence(options, sentence, capsys):
    assert main(["live", *options]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert "Traceback" not in said


@pytest.mark.slow
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_ctrl_c_ends_it_cleanly_and_a_kill_loses_no_reading(ending, tmp_path):
    messages = pose_messages(swaying())
    with Endpoint("igtl-server://:0") as peer:
        where = f"igtl://127.0.0.1:{peer.address.port}?clock=arrival"
        places = ["--at", "base=0", "--at", f"tip={ROBOT.length}", "--journal", tmp_path / "log"]
        command = [sys.executable, "-m", "glissando", "live", "--robot", "tdcr466", "--source"]
        process = subprocess.Popen(
            [*command, where, *map(str, places)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            until(lambda: peer.receive() or peer.peers, within=120.0)
            for _, wire in messages[:40]:
                until(lambda wire=wire: peer.send([wire]))
                until(lambda: not peer.receive(), within=1.0)
            tip = tmp_path / "log" / "tip.csv"
            until(lambda: tip.exists() and tip.read_text().count("\n") == 41, within=120.0)
            os.kill(process.pid, ending)
            said, errors = process.communicate(timeout=30)
        finally:
            process.kill()
        until(lambda: peer.receive() or not peer.peers)  # its own process is gone, too
    assert "Traceback" not in errors
    if ending != signal.SIGKILL:
        assert process.returncode == 0
        assert "Journal" in said
    assert load_recording(tmp_path / "log").streams["tip"].rows.time.size == 40
