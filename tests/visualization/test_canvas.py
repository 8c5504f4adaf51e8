"""What all figures share: a film's pace, and colours that show."""

import warnings

import numpy as np
import pytest
from PIL import Image

from glissando.visualization.canvas import (
    canvas,
    gif_rate,
    legend,
    legend_entries,
    line_colours,
    shown_name,
)


@pytest.mark.slow
@pytest.mark.parametrize("lasts", [0.5, 1.0, 2.0, 4.0, 7.0, 30.0])
def test_a_film_lasts_as_long_as_the_motion(tmp_path, lasts):
    from matplotlib.animation import PillowWriter

    rate = gif_rate(60 / lasts)
    count = max(2, round(rate * lasts))
    with canvas(1.0, 1.0) as figure:
        writer = PillowWriter(fps=rate)
        with writer.saving(figure, tmp_path / "film.gif", dpi=40):
            for k in range(count):
                figure.patch.set_facecolor((k / count, k % 2, 0.0))  # frames alike are made one
                writer.grab_frame()
    with Image.open(tmp_path / "film.gif") as film:
        delays = []
        for k in range(film.n_frames):
            film.seek(k)
            delays.append(film.info["duration"])
    assert min(delays) >= 20  # ms: browsers slow down what is faster
    assert sum(delays) / 1e3 == pytest.approx(lasts, rel=0.05)


@pytest.mark.parametrize("count", [1, 6, 7, 20])
def test_as_many_lines_as_there_are_have_colours_that_show_and_differ(count):
    from matplotlib.colors import to_rgb

    colours = np.array([to_rgb(colour) for colour in line_colours(count)])
    assert len(np.unique(colours.round(3), axis=0)) == len(colours) == count
    assert np.all(colours.min(axis=1) < 0.9)  # white is the paper


@pytest.mark.parametrize("seed", range(3))
def test_a_legend_shows_every_name_as_it_is_and_within_the_figure(seed):
    rng = np.random.default_rng(seed)
    letters = np.array(list("ab_$^{}& <>"))
    names = ["_x", "coil $x^$", "$$", *("".join(rng.choice(letters, 30)) for _ in range(5))]
    with canvas(8.0, 4.0) as figure:
        axes = figure.subplots()
        for name in names:
            axes.plot([0.0, 1.0], label=shown_name(name))
        legend(figure, legend_entries(axes), loc="outside upper center", ncols=5)
        figure.draw_without_rendering()
        (drawn,) = figure.legends
        extent = drawn.get_window_extent()
        assert extent.x0 >= 0.0
        assert extent.x1 <= figure.bbox.width
        assert len(drawn.texts) == len(names)
        for name, text in zip(names, drawn.texts, strict=True):
            assert text._preprocess_math(text.get_text())[0].strip() == name.strip()


def test_a_name_that_is_too_long_keeps_its_ends():
    shown = shown_name("left" * 30 + "right" * 30)
    assert shown.startswith("left")
    assert shown.endswith("right")
    assert len(shown) <= 41


@pytest.mark.parametrize("family", ["DejaVu Sans", "DejaVu Sans Mono"])
@pytest.mark.parametrize("seed", range(3))
def test_any_name_is_one_line_that_its_font_can_draw(seed, family):
    rng = np.random.default_rng(seed)
    codes = rng.choice([*range(1, 0x300), *range(0x3040, 0x9FFF), 0x1F600, 0x20000, 0x200B], 30)
    names = ["線圈", "a\nb", "\t", *("".join(map(chr, few)) for few in codes.reshape(-1, 3))]
    with canvas(8.0, 12.0, {"font.family": family}) as figure:
        axes = figure.subplots()
        for i, name in enumerate(names):
            weight = "bold" if i % 2 else "normal"
            axes.text(0.0, i / len(names), shown_name(name), fontweight=weight)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a missing glyph is a warning and a box
            figure.draw_without_rendering()
        assert all("\n" not in text.get_text() for text in axes.texts)


@pytest.mark.parametrize("name", ["coil Ä ü", "σ ± 2", "мост", "coil 😀"])
def test_letters_that_the_font_has_stay(name):
    with canvas(1.0, 1.0):
        assert shown_name(name) == name
