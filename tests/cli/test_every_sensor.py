"""Commands take every sensor that `simulate` writes, also those that read more than one state."""

import json

import pytest

from glissando.cli.main import main


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [["--tendons"], ["--dynamic"]], ids=" ".join)
def test_recordings_of_tendons_and_accelerometers_are_estimated_checked_and_replayed(
    tmp_path, capsys, sensors
):
    folder = str(tmp_path / "recording")
    assert main(["simulate", "--shape", "C", "--duration", "1.5", *sensors, "--out", folder]) == 0
    for command in (["estimate"], ["check"], ["check", "--leave-out"], ["replay"]):
        assert main([*command, folder]) == 0
        assert "Traceback" not in "".join(capsys.readouterr())


@pytest.mark.slow
def test_truth_in_a_channel_is_judged_alike_by_every_command(tmp_path, capsys):
    folder, results = str(tmp_path / "recording"), str(tmp_path / "results")
    made = ["--shape", "C", "--duration", "1.5", "--channel", "0.004,0.5"]
    assert main(["simulate", *made, "--out", folder]) == 0
    bodies = ",".join(f"mocap_{place}" for place in (100, 220, 340, 460, 580, 700))
    given = ["--use", bodies, "--truth", "coil", "--json"]
    capsys.readouterr()
    assert main(["estimate", folder, *given, "--out", results]) == 0
    first = json.loads(capsys.readouterr().out)["overall"]
    assert main(["check", f"{results}/posterior.nc", "--recording", folder, *given]) == 0
    checked = json.loads(capsys.readouterr().out)["checks"][0]
    assert checked["nees"] == pytest.approx(first["nees_position"])
    assert main(["replay", folder, *given]) == 0
    online = json.loads(capsys.readouterr().out)["lagged"]["overall"]
    assert first["position_rmse"] < 3.5e-3  # beside the backbone it would be 4 mm off and more
    assert online["position_rmse"] == pytest.approx(first["position_rmse"], rel=0.1)
