"""The guard as commands show it: what is refused, allowed, left out and reported."""

import json
from dataclasses import replace

import pytest

from glissando.cli.main import main
from glissando.evaluation.plausibility.examine import examine
from glissando.evaluation.run import checked_window, chosen_streams
from glissando.io.recording_folder import load_recording


def edited(folder, tmp_path, change):
    """The recording with another coil.csv."""
    out = tmp_path / "wrong"
    out.mkdir()
    for file in folder.iterdir():
        text = file.read_text()
        if file.name == "coil.csv":
            head, *rows = text.splitlines()
            rows = [change([float(cell) for cell in row.split(",")]) for row in rows]
            text = "\n".join([head, *(",".join(map(str, row)) for row in rows)])
        (out / file.name).write_text(text)
    return out


def millimetres(row):
    return [*row[:2], *(1e3 * x for x in row[2:5]), *row[5:]]


@pytest.mark.slow
def test_the_command_line_refuses_names_the_cause_and_obeys(folder, tmp_path, capsys):
    wrong = edited(folder, tmp_path, millimetres)
    for command in ("estimate", "check"):
        assert main([command, str(wrong)]) == 2
        told = capsys.readouterr().err
        assert "positions are probably in millimetres" in told
        assert "--allow length-unit" in told
    assert main(["estimate", str(wrong), "--allow", "lengthunit"]) == 2
    assert "is not a check" in capsys.readouterr().err
    description = wrong / "recording.toml"
    description.write_text('allow = ["length-unit", "noise"]\n' + description.read_text())
    assert "length-unit" not in {f.name for f in _of_recording(wrong)}


def _of_recording(folder):
    recording = load_recording(folder)
    streams = chosen_streams(recording, recording.robot, recording.span(), None, None)[:2]
    return examine(recording.robot, *streams, frames=recording.frames, allow=recording.allow)


def test_a_reading_out_of_reach_is_named_and_left_out(folder, tmp_path, capsys):
    """One reading a kilometre off is named with its row, and the answer is that without it."""
    rows, chosen = iter(range(10**6)), 61

    def kilometre(row):
        return [*row[:2], row[2] + 1e3, *row[3:]] if next(rows) == chosen else row

    wrong = edited(folder, tmp_path, kilometre)
    answers = []
    for recording in (folder, wrong):
        assert main(["estimate", str(recording), "--window", "1", "2", "--json"]) == 0
        told = capsys.readouterr()
        answers.append(json.loads(told.out))
    assert answers[1]["dropped"] == {"coil": {"out of reach": 1}}
    assert f"Row {chosen - 40} of 'coil'" in told.err
    right, without = (a["overall"]["position_rmse"] for a in answers)
    assert without == pytest.approx(right, rel=0.1)


def test_findings_stand_in_the_report(folder, capsys):
    assert main(["estimate", str(folder), "--window", "1", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["findings"] == []


def test_the_default_window_is_that_of_the_sensors(folder):
    recording = load_recording(folder)
    body, coil = (
        next(s for s in recording.streams.values() if s.truth == t) for t in (True, False)
    )
    longer = replace(body, rows=replace(body.rows, time=2.0 * body.rows.time))
    streams = {**recording.streams, longer.name: longer}
    found = checked_window(replace(recording, streams=streams), None)
    assert found == (coil.rows.time[0], coil.rows.time[-1])
    assert recording.span()[1] != replace(recording, streams=streams).span()[1]
