"""An option that has no effect beside the others is refused with one sentence."""

import json

import pytest

from glissando.cli.main import main


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("silent")
    (folder / "rec").mkdir()
    (folder / "rec" / "recording.toml").write_text(
        'robot = "sliding700"\n[[streams]]\nname = "coil"\nkind = "coil"\n'
    )
    head = "time,arclength,x,y,z,qw,qx,qy,qz\n"
    (folder / "rec" / "coil.csv").write_text(head + "0,0.7,0,0,0.7,1,0,0,0\n")
    (folder / "still.toml").write_text('robot = "sliding700"\n[mocap]\n')
    for words in (["plan", "--zone", "0.5:0.6"], ["study", "sweep.toml"]):
        report = {"request": words, "inputs": {}, "versions": {}}
        (folder / f"{words[0]}.json").write_text(json.dumps(report))
    (folder / "results").mkdir()
    for saved in ("posterior.nc", "results/posterior.nc"):
        (folder / saved).write_text("not read")
    return folder


@pytest.mark.parametrize(
    ("words", "to"),
    [
        ("check rec --level 0.5", "a check without --store-tube"),
        ("check rec --block 1", "a check without --store-tube"),
        ("check rec --prior-factor 2", "a check without --draws"),
        ("check rec --seed 2", "a check without --draws"),
        ("check rec --recording rec", "a recording, which has its own truth"),
        ("check posterior.nc --recording rec --leave-out", "a posterior"),
        ("check posterior.nc --recording rec --window 0 1", "a posterior"),
        ("check results --recording rec --window 0 1", "a posterior"),
        ("check --draws 20 --robot sliding700 --store-tube t.toml", "--draws"),
        ("check --draws 20 --robot sliding700 --window 0 1", "--draws without a recording"),
        ("design --zone 0:0.7 --sensor coil=1 --strokes 0.1", "--sensor"),
        ("design --zone 0:0.7 --sensor coil=1 --coils 1", "--sensor"),
        ("design --zone 0:0.7 --sensor coil=1 --stream a", "--sensor"),
        ("design --zone 0:0.7 --budget 1", "a design without --sensor"),
        ("design --zone 0:0.7 --places 3", "a design without --sensor"),
        ("design --zone 0:0.7 --bound 1", "--objective trace"),
        ("import x.csv --out o --estimate rec --shift a=1", "--estimate"),
        ("import x.csv --out o --estimate rec --rate 9", "--estimate without --arclength"),
        ("plan --zone 0.5:0.6 --figure pdf", "a plan without --scene"),
        ("plan --zone 0.5:0.6 --bound 0.1", "--objective trace"),
        ("plan --scene scene.toml --horizon 3", "--scene"),
        ("plan --scene scene.toml --from posterior.nc", "--scene"),
        ("live --source rec --slide oscillate", "sources without a stage"),
        ("live --source rec --stroke 0.02", "sources without a stage"),
        ("live --source rec --at Tip=0.7", "sources that say where their sensors are"),
        ("record --setup still.toml --out o --slide hold", "a rig without a stage"),
        ("record --setup still.toml --out o --seed 2", "--setup"),
        ("record --setup still.toml --out o --channel 0.004,0.5", "--setup"),
        ("record --simulate --out o --slide hold --stroke 0.02", "--slide hold"),
        ("record --simulate --out o --slide calibrate --speed 0.02", "--slide calibrate"),
        ("record --simulate --out o --duration 5", "--slide oscillate"),
        ("export rec --stream coil --out coil.tum --rate 9", "--stream"),
        ("figure shape posterior.nc --out a.png --window 0 1", "a posterior"),
        ("figure shape posterior.nc --out a.png --robot r", "a figure of a posterior without"),
        ("figure error rec --out a.png --times 1", "the figure error"),
        ("view posterior.nc --html a.html --allow shape", "a posterior"),
        ("view rec --html a.html --recording rec", "a recording"),
        ("view rec --port 9000", "a view without --live"),
        ("view rec --html a.html --live", "--live"),
        ("rerun plan.json --recording nowhere", "a report that names no recording"),
        ("rerun study.json --robot sliding700", "a report of study"),
        ("design --zone 0:0.7 --sensor coil=1 --limits 0.1,0.1,1", "sensors without one of slide"),
    ],
)
def test_an_option_without_effect_is_refused(place, monkeypatch, capsys, words, to):
    monkeypatch.chdir(place)
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    assert said.startswith("glissando: --")
    assert f" has no effect on {to}" in said
    assert said.endswith("; leave it out.\n")
