"""Commands take every sensor that `simulate` writes, also those that read more than one state."""

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
