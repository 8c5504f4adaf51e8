"""What is exported is what the posterior says, in the formats of other programs."""

import json

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from glissando import Posterior, estimate
from glissando.cli.main import main
from glissando.errors import GlissandoError, OutsideGridError
from glissando.io.foreign import export, read_tracks
from glissando.io.foreign.trajectories import SCHEMAS
from glissando.io.netcdf import save_posterior
from glissando.io.provenance import stated_format
from glissando.io.query_csv import QUERY_COLUMNS
from scenes import LENGTH, sliding_scene


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    prior, grid, readings = sliding_scene()
    return estimate(prior, grid, readings)


def test_a_tum_file_holds_time_position_and_quaternion_with_w_last(posterior, tmp_path):
    count = export(posterior, tmp_path / "a.tum", arclength=np.array([0.3]), rate=50.0)
    table = np.loadtxt(tmp_path / "a.tum")
    assert table.shape == (count, 8) == (51, 8)
    np.testing.assert_allclose(table[:, 0], np.arange(51) / 50, atol=1e-12)
    at = posterior.at(0.3, table[:, 0])
    np.testing.assert_allclose(table[:, 1:4], at.position, atol=1e-10)
    turned = Rotation.from_quat(table[:, 4:]).as_matrix()  # SciPy too has w last
    np.testing.assert_allclose(turned, at.pose[:, :3, :3], atol=1e-10)


def test_what_was_exported_as_tum_is_imported_as_it_is(posterior, tmp_path):
    export(posterior, tmp_path / "tip.tum", rate=50.0)
    (track,) = read_tracks(tmp_path / "tip.tum")
    assert track.name == "tip"
    at = posterior.at(LENGTH, track.time)
    np.testing.assert_allclose(track.values, at.pose, atol=1e-9)


def test_without_an_arclength_tum_is_the_tip_at_the_time_nodes(posterior, tmp_path):
    export(posterior, tmp_path / "a.txt")
    table = np.loadtxt(tmp_path / "a.txt")
    np.testing.assert_allclose(table[:, 0], posterior.grid.time, rtol=1e-14)
    np.testing.assert_allclose(table[:, 1:4], posterior.at(LENGTH, table[:, 0]).position, atol=1e-9)


def test_a_csv_has_a_row_for_each_time_and_place(posterior, tmp_path):
    export(posterior, tmp_path / "a.csv", arclength=np.array([0.1, 0.4]), rate=2.0)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0].split(",") == QUERY_COLUMNS
    table = np.loadtxt(lines[1:], delimiter=",")
    assert table[:, :2].tolist() == [[t, s] for t in (0, 0.5, 1) for s in (0.1, 0.4)]
    at = posterior.at(table[:, 1], table[:, 0])
    np.testing.assert_allclose(table[:, 2:5], at.position, atol=1e-10)
    np.testing.assert_allclose(table[:, 21:].reshape(-1, 6, 6), at.cov[:, :6, :6], rtol=1e-9)


def fits(value, schema):
    """Whether a value is what a JSON schema of the few words that we use allows."""
    kinds = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float)}
    kind = schema["type"][0] if isinstance(schema["type"], list) else schema["type"]
    if not isinstance(value, kinds[kind]) or isinstance(value, bool):
        return False
    if kind == "object":
        known = schema["properties"]
        return value.keys() == known.keys() and all(fits(v, known[k]) for k, v in value.items())
    if kind == "array":
        low, high = schema.get("minItems", 0), schema.get("maxItems", np.inf)
        return low <= len(value) <= high and all(fits(v, schema["items"]) for v in value)
    return True


def test_an_mcap_file_is_read_by_its_own_reader_and_fits_its_schemas(posterior, tmp_path):
    out = tmp_path / "a.mcap"
    for _ in range(2):  # the second time over the first
        count = export(posterior, out, arclength=np.array([0.2, 0.466, 0.3]), rate=20.0)
    found = {topic: [] for topic in SCHEMAS}
    with out.open("rb") as file:
        (about,) = make_reader(file).iter_metadata()
        assert about.metadata["format"] == stated_format("posterior")
        file.seek(0)
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert schema.name == SCHEMAS[channel.topic]["title"]
            told = json.loads(message.data)
            assert fits(told, json.loads(schema.data)), channel.topic
            found[channel.topic].append((message.log_time, told))
    assert {topic: len(rows) for topic, rows in found.items()} == dict.fromkeys(SCHEMAS, count)
    for k, (now, told) in enumerate(found["/estimate"]):
        assert now == k * 50_000_000
        at = posterior.at(told["arclength"], told["time"])
        np.testing.assert_allclose(told["position"], at.position, atol=1e-12)
        np.testing.assert_allclose(told["cov_pose"], at.cov[:, :6, :6], rtol=1e-9)
        pose = found["/tip"][k][1]["pose"]
        assert found["/shape"][k][1]["poses"][1] == pose  # 0.466 m is the farthest
        assert [pose["position"][i] for i in "xyz"] == told["position"][1]
        assert [pose["orientation"][i] for i in "wxyz"] == told["quaternion"][1]
        stamp = found["/tip"][k][1]["timestamp"]
        assert stamp["sec"] * 10**9 + stamp["nsec"] == now


@pytest.mark.parametrize(
    ("name", "options", "error", "sentence"),
    [
        ("a.bvh", {}, GlissandoError, r"a.bvh says no format; give --out a name in .tum, .txt"),
        ("a.tum", {"arclength": np.array([0.1, 0.2])}, GlissandoError, "one trajectory.*, not 2"),
        ("a.tum", {"rate": -1.0}, GlissandoError, "A rate of -1 Hz cannot be"),
        ("a.tum", {"rate": float("nan")}, GlissandoError, "A rate of nan Hz cannot be"),
        (
            "a.mcap",
            {"arclength": np.array([0.1, 0.5])},
            OutsideGridError,
            r"row 1 has arclength 0.5 m, .* Ask for what lies inside\.",
        ),
    ],
)
def test_what_cannot_be_exported_says_why(posterior, tmp_path, name, options, error, sentence):
    with pytest.raises(error, match=sentence):
        export(posterior, tmp_path / name, **options)
    assert not any(tmp_path.iterdir())


def test_mcap_refuses_times_before_zero(tmp_path):
    prior, grid, readings = sliding_scene()
    early = [r.changed(time=r.time - 0.5) for r in readings]
    moved = type(grid)(grid.arclength, grid.time - 0.5)
    with pytest.raises(GlissandoError, match=r"begins at -0\.5 s"):
        export(estimate(prior, moved, early), tmp_path / "a.mcap")


def test_the_command_exports_what_estimate_saved(posterior, tmp_path, capsys):
    saved, out = tmp_path / "posterior.nc", tmp_path / "out" / "tip.tum"
    save_posterior(posterior, saved)
    arguments = ["export", str(saved), "--out", str(out), "--arclength", "0.466", "--rate", "10"]
    assert main(arguments) == 0
    assert "11 times" in capsys.readouterr().out
    assert np.loadtxt(out).shape == (11, 8)
    assert main([*arguments[:-3], "tip", "--rate", "10"]) == 2
    assert "--arclength 'tip' is not a number" in capsys.readouterr().err
