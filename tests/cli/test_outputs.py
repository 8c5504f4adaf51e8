"""What commands write replaces nothing that was recorded, and is there whatever stdout does."""

import pytest

from glissando.cli.main import main


def run(*arguments):
    return main([str(a) for a in arguments])


_TOML = """\
robot = "sliding700"

[[streams]]
name = "coil"
kind = "coil"

[[streams]]
name = "mocap_700"
kind = "pose"
truth = true
"""


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A recording of a straight robot at rest."""
    folder = tmp_path_factory.mktemp("recordings") / "held"
    folder.mkdir()
    (folder / "recording.toml").write_text(_TOML)
    for name in ("coil", "mocap_700"):
        rows = [f"{k / 20},0.7,0,0,0.7,1,0,0,0\n" for k in range(21)]
        (folder / f"{name}.csv").write_text("time,arclength,x,y,z,qw,qx,qy,qz\n" + "".join(rows))
    return folder


@pytest.mark.parametrize(
    "words",
    [
        "export {rec} --stream coil --out {rec}/coil.csv",
        "learn {rec} --robot sliding700 --out {rec}/coil.csv",
        "learn {rec} --robot sliding700 --out {rec}/recording.toml",
        "view {rec} --html {rec}/coil.csv",
        "report {rec} --out {rec}/coil.csv",
        "report {rec}/coil.csv --out {rec}/../held/coil.csv",
        "check {rec} --store-tube {rec}/coil.csv",
        "calibrate {rec} --out {rec}/coil.csv",
    ],
)
def test_what_was_recorded_is_not_replaced(held, capsys, words):
    before = {p.name: p.read_bytes() for p in held.iterdir()}
    assert run(*words.format(rec=held).split()) == 2
    assert "would replace data; give another name or folder" in capsys.readouterr().err
    assert {p.name: p.read_bytes() for p in held.iterdir()} == before


def test_a_file_of_ones_own_is_replaced(held, tmp_path):
    out = tmp_path / "coil.tum"
    out.write_text("old")
    assert run("export", held, "--stream", "mocap_700", "--out", out) == 0
    assert out.read_text() != "old"
