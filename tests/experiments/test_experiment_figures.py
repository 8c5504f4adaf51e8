"""Figures of the experiments: drawn to scale, with units, whatever arms a quick run leaves out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("matplotlib")
from mpl_toolkits.mplot3d.proj3d import proj_transform

from glissando.experiments.confidence import nearest_minimum, std_along
from glissando.experiments.figures_bodies import coil_figure, following_figure
from glissando.experiments.figures_numbers import causes_figure, moving_figure, table_figure
from glissando.experiments.run import save_experiment_figures
from glissando.experiments.scenes import Scene, bench, path, trial

LENGTH = bench().rod.length


def number(value, half=0.05):
    half = half * abs(value)
    return {"value": value, "low": value - half, "high": value + half}


def summary(position, rotation, change=-5.0, **more):
    out = {"position": number(position), "rotation": number(rotation), "seeds": 4}
    out |= {"nees": number(1.0), "coverage": number(0.95)}
    return {**out, "position_change": number(change), "rotation_change": number(change), **more}


def table(scale):
    shares = {"fixed": 1.0, "oscillating": 0.95, "traverse": 0.7, "traverse fast": 0.6}
    shares |= {"still fixed": 0.98, "still traverse": 0.4}
    size = {"C": (0.0164, 0.078), "S": (0.0178, 0.238)}
    return {
        shape: {arm: summary(scale * p * k, scale * r * k) for arm, k in shares.items()}
        for shape, (p, r) in size.items()
    }


def moving():
    def arm(share, speed, stroke):
        return summary(0.005 * share, 0.05 * share, slide_speed=speed, stroke=stroke)

    arms = {"fixed": arm(1.0, 0.0, 0.0), "oscillating": arm(0.9, 0.02, 0.06)}
    arms |= {"traverse": arm(0.8, 0.05, 0.7), "traverse fast": arm(0.6, 0.19, 0.7)}
    return {"5 s": arms, "20 s": {"fixed": arms["fixed"], "traverse": arms["traverse"]}}


CAUSES = {
    "as it is": {"C": summary(0.01, 0.1, -6.0), "S": summary(0.01, 0.1, -8.0)},
    "bias × 3": {"C": summary(0.01, 0.1, -15.0)},
    "no set": {"S": {"position": number(0.01), "rotation": number(0.1)}},
}


@pytest.fixture(scope="module")
def confidence():
    trials, told = {}, {}
    for name in ("straight tip", "straight inside", "C inside"):
        shape, kind = name.split()
        at = {"tip": 0.0, "inside": 0.06}[kind]
        trials[name] = trial(Scene(shape, "hold", 1.0, at=at), seed=0)
        low = nearest_minimum(*std_along(trials[name], 0.5), LENGTH - at)
        told[name] = {"coil": LENGTH - at, "minimum": low, "distance": abs(low - LENGTH + at)}
    return {**told, "worst": 0.0}, trials


@pytest.fixture(scope="module")
def following():
    scene = Scene("C", "traverse", 2.0, speed=0.7, stroke=LENGTH, cycles=1)
    rows = {}
    for time in (0.0, 0.5):
        coil = LENGTH - float(path(scene).at(time))
        rows[f"{time:g}"] = {"coil": coil, "minimum": coil - 0.004, "distance": 0.004}
    return {"instants": rows, "worst": 0.004}, trial(scene, seed=0), scene


def spaces(figure):
    return [axes for axes in figure.axes if axes.name == "3d"]


def flats(figure):
    return [axes for axes in figure.axes if axes.name != "3d"]


def on_paper(axes, *points):
    """Points (M, 3) of axes in space where they are drawn, pixels."""
    seen = proj_transform(*np.array(points, dtype=float).T, axes.get_proj())[:2]
    return axes.transData.transform(np.stack(seen, axis=1))


def labels(figure):
    figure.canvas.draw()
    axes = [a for each in figure.axes for a in (each.xaxis, each.yaxis)]
    return {a.label.get_text() for a in axes} - {""}


def assert_legible(figure):
    figure.canvas.draw()
    for axes in flats(figure):
        shown = [t for t in axes.get_xticklabels() if t.get_visible() and t.get_text()]
        boxes = sorted(t.get_window_extent().extents[[0, 2]].tolist() for t in shown)
        inside = [b for b in boxes if b[1] > axes.bbox.x0 and b[0] < axes.bbox.x1]
        assert all(a[1] < b[0] for a, b in pairwise(inside))


@pytest.mark.slow
def test_robots_hang_at_one_scale_and_a_missing_trial_leaves_a_gap(confidence):
    told, trials = confidence
    figure = coil_figure(trials, told)
    figure.canvas.draw()
    drawn = [on_paper(axes, [0, 0, 0], [0, 0, 100], [100, 0, 100]) for axes in spaces(figure)]
    assert len(drawn) == 4  # one of which is empty: there is no "C tip"
    assert all(base[1] > below[1] + 10 for base, below, _ in drawn)
    assert all(right[0] > below[0] + 10 for _, below, right in drawn)
    steps = np.diff(drawn, axis=1)
    assert np.allclose(steps, steps[0], rtol=0.01, atol=0.2)
    assert {"arclength (mm)", "position std. dev. (mm)", "x (mm)", "y (mm)"} <= labels(figure)
    assert "z (mm)" in {text.get_text() for text in figure.texts}
    assert_legible(figure)


def test_dots_are_at_the_minima_of_the_curves(confidence):
    told, trials = confidence
    straight, c = flats(coil_figure(trials, told))
    dots = [line for line in straight.lines if line.get_marker() == "o"]
    wanted = [1e3 * told[f"straight {kind}"]["minimum"] for kind in ("tip", "inside")]
    assert np.allclose([dot.get_xdata()[0] for dot in dots], wanted)
    assert all(0.0 < dot.get_ydata()[0] < 3.0 for dot in dots)
    assert sum(line.get_marker() == "o" for line in c.lines) == 1


@pytest.mark.slow
def test_the_coil_slides_in_from_the_tip(following):
    told, found, scene = following
    figure = following_figure(found, scene, told)
    assert len(spaces(figure)) == 6
    curves, way = flats(figure)
    coils = [marks.get_offsets()[0, 0] for marks in curves.collections]
    assert coils[0] == pytest.approx(1e3 * LENGTH)
    assert np.all(np.diff(coils) <= 0.0)
    assert coils[-1] < 300.0
    minimum = next(line for line in way.lines if line.get_label() == "minimum")
    assert np.allclose(minimum.get_ydata(), [1e3 * r["minimum"] for r in told["instants"].values()])
    wanted = {"arclength (mm)", "position std. dev. (mm)", "time (s)", "x (mm)", "y (mm)"}
    assert wanted <= labels(figure)
    assert "4.0 mm" in way.get_title(loc="left")
    assert_legible(figure)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.15])
def test_a_table_shows_the_papers_values_however_far_they_are(scale):
    figure = table_figure(table(scale))
    assert labels(figure) == {"position RMSE (cm)", "orientation RMSE (rad)"}
    assert len(figure.axes) == 4
    hollow = []
    for axes in figure.axes:
        low, high = axes.get_xlim()
        hollow += [line.get_xdata()[0] for line in axes.lines if hollow_(line)]
        assert all(low < x < high for line in axes.lines for x in line.get_xdata())
    assert np.allclose(sorted(hollow), [0.0754, 0.0779, 0.2291, 0.2381, 1.54, 1.63, 1.64, 1.78])
    assert_legible(figure)


def hollow_(line):
    return line.get_marker() == "D" and line.get_markerfacecolor() == "white"


def test_a_table_of_a_quick_run_has_only_its_own_rows():
    arms = table(0.5)["C"]
    figure = table_figure({"C": {"fixed": arms["fixed"], "traverse": arms["traverse"]}})
    names = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert names == ["fixed at the tip", "whole length"]


def test_a_moving_robot_is_a_column_a_duration():
    figure = moving_figure(moving())
    assert len(figure.axes) == 4
    wanted = {"mean slide speed (mm/s)", "position RMSE (cm)", "orientation RMSE (rad)"}
    assert labels(figure) == wanted
    titles = [axes.get_title(loc="left") for axes in figure.axes[:2]]
    assert titles == ["C to S in 5 s", "C to S in 20 s"]
    traverse = next(line for line in figure.axes[0].lines if line.get_marker() == "v")
    assert np.allclose(traverse.get_xdata(), [50.0, 190.0])
    assert np.allclose(traverse.get_ydata(), [0.4, 0.3])
    entries = [text.get_text() for text in figure.legends[0].texts]
    assert entries == ["fixed at the tip", "sliding by 60 mm", "sliding by 700 mm"]
    assert_legible(figure)


def test_causes_leave_out_what_was_not_computed():
    figure = causes_figure(CAUSES)
    assert labels(figure) == {"change of RMSE by oscillating (%)"}
    position, rotation = figure.axes
    names = [text.get_text() for text in position.get_yticklabels()]
    assert names == ["as it is", "bias × 3", "no set"]
    for axes, paper in ((position, [-8.4, -6.1]), (rotation, [-3.8, -3.2])):
        upright = {line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1}
        assert {0.0, *paper} <= upright
        dots = sorted(line.get_xdata()[0] for line in axes.lines if line.get_marker() in "os")
        assert np.allclose(dots, [-15.0, -8.0, -6.0])
    assert_legible(figure)


@pytest.mark.slow
def test_only_figures_with_results_are_written(tmp_path, confidence, following):
    results = {"table": table(1.0), "moving": moving(), "causes": {}}
    folder = tmp_path / "new" / "folder"
    args = (confidence[1], *following[1:], folder)
    written = [folder / "table.png", folder / "moving.png"]
    assert save_experiment_figures(results, *args) == written
    results |= {"confidence": confidence[0], "following": following[0], "causes": CAUSES}
    paths = save_experiment_figures(results, *args)
    names = ["confidence", "following", "table", "moving", "causes"]
    assert [path.stem for path in paths] == names
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in paths)
