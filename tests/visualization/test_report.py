"""Runs side by side on one page: their numbers, their changes, their scenes."""

import json
import re
from html import unescape

import pytest
from PIL import Image

from browser import Told, chromium, wait_until
from glissando import estimate
from glissando.cli.main import main
from glissando.evaluation.metrics import errors_against
from glissando.evaluation.run import Run
from glissando.io.netcdf import save_posterior
from glissando.io.recording import Recording
from glissando.io.robot_file import load_robot
from glissando.model.sensors.sensors import PoseReadings
from glissando.visualization.page import save_view, svg
from pages import OUTSIDE
from scenes import LENGTH, arc, sliding_scene


def written(folder, name, keep):
    """A run written as `estimate --view --out` writes it, using the streams to keep."""
    prior, grid, readings = sliding_scene(duration=0.5)
    readings = [r for r in readings if r.name in keep]
    time = grid.time[1:-1]
    truth = []
    for place in (LENGTH / 2, LENGTH):
        at = [place] * time.size
        label = f"mocap_{1e3 * place:.0f}"
        truth.append(
            PoseReadings(time=time, arclength=at, values=arc(at, time), cov=1e-8, name=label)
        )
    posterior = estimate(prior, grid, readings)
    errors = [errors_against(posterior, t) for t in truth]
    robot = load_robot("tdcr466")
    recording = Recording(name, folder, {}, robot, None)
    run = Run(recording, robot, (0.0, 0.5), readings, truth, {}, posterior, errors)
    folder.mkdir()
    (folder / "report.json").write_text(json.dumps(run.as_json()))
    save_posterior(posterior, folder / "posterior.nc")
    for figure in ("shape", "confidence", "error"):
        Image.new("RGB", (4, 3)).save(folder / f"{figure}.png")
    save_view(posterior, folder / "view.html", readings=readings, truth=truth, title=name)
    return json.loads((folder / "report.json").read_text())


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    above = tmp_path_factory.mktemp("runs")
    told = {
        name: written(above / name, f"<{name}>", keep)
        for name, keep in (("fixed", ("base", "gyro")), ("sliding", ("base", "coil", "gyro")))
    }
    return above, told


@pytest.fixture(scope="module")
def html(runs):
    above, _ = runs
    folders = [str(above / "fixed"), str(above / "sliding")]
    assert main(["report", *folders, "--out", str(above / "report.html")]) == 0
    return (above / "report.html").read_text(encoding="utf-8")


def tables(html):
    """Every table of the page as rows of texts."""
    found = re.findall(r"<tbody>(.*?)</tbody>", re.sub(r'srcdoc=".*?"', "", html))
    return [
        [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", table)]
        for table in found
    ]


def test_the_page_tells_the_numbers_of_the_runs_and_changes_in_per_cent(runs, html):
    _, told = runs
    position, rotation, innovations, settings = tables(html)
    assert [row[0] for row in position] == ["mocap_233", "mocap_466", "all"]
    for table, quantity, scale in ((position, "position", 1e3), (rotation, "rotation", 57.29578)):
        for row in table:
            sites = [run["sites"] + [{**run["overall"], "name": "all"}] for run in told.values()]
            entries = [next(s for s in each if s["name"] == row[0]) for each in sites]
            before, after = (scale * entry[f"{quantity}_rmse"] for entry in entries)
            assert row[1] == f"{before:.2f}"
            assert row[5] == f"{after:.2f}"
            assert row[6].replace("−", "-") == f"{100 * (after / before - 1):+.1f} %"
            consistency = told["sliding"]["consistency"]
            checks = {(c["site"], c["quantity"]): c for c in consistency}
            check = checks[row[0], quantity]
            low, high = check["nees_bounds"]
            assert row[7] == f"{check['nees']:.2f} ({low:.2f}…{high:.2f})"
            assert row[8] == f"{100 * check['coverage']['0.95']['share']:.1f} %"
            assert row[9] == check["verdict"]
    assert [row[0] for row in innovations] == ["base", "gyro", "coil"]
    assert innovations[2][1:3] == ["–", "–"]  # the first run had no coil
    rows = {row[0]: row[1:] for row in settings}
    assert rows["prior"] == ["white-noise", "white-noise"]
    assert rows["nodes"] == ["6 times × 4 arclengths"] * 2
    assert [unescape(cell) for cell in rows["recording"]] == ["<fixed>", "<sliding>"]
    assert rows["readings of coil"] == ["–", str(told["sliding"]["readings"]["coil"])]
    assert rows["numpy"][0] == told["fixed"]["versions"]["numpy"]


def test_the_page_needs_nothing_else(html):
    assert not OUTSIDE.search(html.replace("srcdoc=", ""))
    assert html.count("data:image/png;base64,") == 6
    assert html.count("<iframe") == 2


def test_a_chart_has_a_dot_for_every_number_where_it_belongs(runs, html):
    values = {"a": [svg.Dot(1.0), svg.Dot(2.0, (1.0, 4.0))], "b": [None, svg.Dot(4.0)]}
    drawn = svg.chart(["one", "two"], values, "mm")
    circles = [
        (float(x), fill) for x, fill in re.findall(r'<circle cx="([\d.]+)".*?fill="(.*?)"', drawn)
    ]
    zero = float(re.search(r'<line x1="([\d.]+)"', drawn)[1])
    assert [fill for _, fill in circles] == [svg.colour(0), svg.colour(0), svg.colour(1)]
    off = [x - zero for x, _ in circles]
    assert off == pytest.approx([off[0], 2 * off[0], 4 * off[0]], abs=0.2)
    bar = re.search(
        r'x1="([\d.]+)" y1="[\d.]+" x2="([\d.]+)" y2="[\d.]+" stroke="var\(--z\)"', drawn
    )
    assert [float(x) - zero for x in bar.groups()] == pytest.approx([off[0], 4 * off[0]], abs=0.2)
    position = html.count("<circle")
    assert position == 2 * (2 * 3 + 2 * 4)  # sites and levels, for two runs, two quantities


@pytest.mark.parametrize("largest", [0.0, 1e-6, 0.99, 1.0, 3.7, 60.0, 61.0, 4.2e5])
def test_an_axis_ends_in_a_round_number_beyond_the_largest(largest):
    drawn = svg.chart(["one"], {"a": [svg.Dot(largest)]}, "mm")
    marks = [float(t) for t in re.findall(r'middle">([\d.e+-]+)<', drawn)]
    assert marks[0] == 0.0
    assert marks[-1] >= largest * (1 - 1e-6)
    assert 2 <= len(marks) <= 8


def test_one_run_without_truth_or_scene_is_still_a_report(runs, tmp_path):
    told = runs[1]
    bare = {**told["fixed"], "sites": [], "overall": None}
    bare["consistency"] = [c for c in bare["consistency"] if c["quantity"] == "innovation"]
    (tmp_path / "report.json").write_text(json.dumps(bare))
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "r.html")]) == 0
    html = (tmp_path / "r.html").read_text()
    assert "No truth was given" in html
    assert "<iframe" not in html


def test_a_scene_is_made_of_a_posterior_where_none_was_written(runs, tmp_path):
    above, told = runs
    (tmp_path / "report.json").write_text(json.dumps(told["fixed"]))
    (tmp_path / "posterior.nc").write_bytes((above / "fixed" / "posterior.nc").read_bytes())
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "r.html")]) == 0
    assert "<iframe" in (tmp_path / "r.html").read_text()


def test_runs_of_one_name_are_told_apart(runs, tmp_path):
    told = runs[1]
    for name in ("one", "two"):
        (tmp_path / name / "out").mkdir(parents=True)
        (tmp_path / name / "out" / "report.json").write_text(json.dumps(told["fixed"]))
    folders = [str(tmp_path / name / "out") for name in ("one", "two")]
    assert main(["report", *folders, "--out", str(tmp_path / "r.html")]) == 0
    assert "<title>one/out, two/out</title>" in (tmp_path / "r.html").read_text()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, "holds no report.json; make one with glissando estimate"),
        ("{", "was not written by glissando estimate"),
        ('{"sites": []}', "was not written by glissando estimate"),
        ("[]", "was not written by glissando estimate"),
    ],
)
def test_a_folder_that_is_no_run_is_one_sentence(tmp_path, capsys, text, sentence):
    if text:
        (tmp_path / "report.json").write_text(text)
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "r.html")]) == 2
    told = capsys.readouterr().err
    assert sentence in told
    assert told.count("\n") == 1
    assert not (tmp_path / "r.html").exists()


def test_a_run_given_twice_is_one_sentence(runs, capsys):
    folder = str(runs[0] / "fixed")
    assert main(["report", folder, folder + "/", "--out", folder + ".html"]) == 2
    assert "A run is given twice" in capsys.readouterr().err


@pytest.mark.slow
def test_in_a_browser_scenes_share_their_time_and_nothing_else_is_asked_for(runs, html):
    with chromium() as browser:
        tall = {"width": 1280, "height": 6000}  # a browser draws no frame that is out of sight
        context = browser.new_context(offline=True, viewport=tall)
        page = context.new_page()
        told = Told(page)
        page.goto((runs[0] / "report.html").as_uri())
        _, one, other = page.frames
        for frame in (one, other):
            wait_until(frame, "!state.waiting && state.moment === 0")
        one.locator("#stage").press("End")
        wait_until(other, "state.moment === 10")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert told == []


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sites", 3),
        ("window", ["a", "b"]),
        ("consistency", [{"site": "x"}]),
        ("readings", []),
        ("dropped", None),
    ],
)
def test_an_entry_that_nobody_wrote_so_is_one_sentence(runs, tmp_path, capsys, key, value):
    wrong = {**runs[1]["fixed"], key: value}
    (tmp_path / "report.json").write_text(json.dumps(wrong))
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "r.html")]) == 2
    told = capsys.readouterr().err
    assert "estimate again" in told
    assert told.count("\n") == 1


@pytest.mark.slow
def test_a_page_that_somebody_else_wrote_stays_in_its_frame(runs, tmp_path):
    """What stands in a run's view.html may be anybody's: it can neither leave, open nor submit."""
    (tmp_path / "report.json").write_text(json.dumps(runs[1]["fixed"]))
    (tmp_path / "view.html").write_text(
        """<script>
        for (const act of [
          () => { top.location = "about:blank#gone" }, () => window.open("about:blank#new"),
          () => { parent.document.title = "taken" }, () => localStorage.setItem("a", "b"),
          () => document.forms[0].submit(), () => alert(1),
        ]) { try { act() } catch (refused) {} }
        document.title = "tried"
        </script><form action="about:blank#sent"></form>"""
    )
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "r.html")]) == 0
    with chromium() as browser:
        context = browser.new_context(offline=True)
        page, opened = context.new_page(), []
        context.on("page", lambda new: opened.append(new.url))
        page.goto((tmp_path / "r.html").as_uri())
        page.wait_for_timeout(300)
        assert page.url.endswith("r.html")
        assert page.title() == tmp_path.name
        assert not opened
