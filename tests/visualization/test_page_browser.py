"""What a person sees and does on the page, in a real browser without a network."""

import io
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image

from browser import Told, chromium, wait_until
from glissando import estimate
from glissando.estimation.confidence_tube import SIGMAS_95, confidence_tube
from glissando.visualization.page import save_view, scene_of
from pages import carried, unpacked
from scenes import LENGTH, sliding_scene

SIZE = {"width": 1000, "height": 900}


@pytest.fixture(scope="module")
def posterior():
    prior, grid, readings = sliding_scene(duration=1.0)
    return estimate(prior, grid, readings), readings


@pytest.fixture(scope="module")
def file(posterior, tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "view.html"
    return save_view(posterior[0], path, readings=posterior[1], title="bend")


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@contextmanager
def opened(browser, file, script="", **look):
    context = browser.new_context(**{"viewport": SIZE, "offline": True, **look})
    context.add_init_script(script)
    page = context.new_page()
    told = Told(page)
    page.goto(file.as_uri())
    settled(page)
    yield page
    assert told == []  # nothing was asked for beyond the file, and nothing went wrong
    context.close()


@pytest.fixture
def page(browser, file):
    with opened(browser, file, color_scheme="light") as shown:
        yield shown


def settled(page):
    """Wait until what was asked to be drawn has been."""
    wait_until(page, "!state.waiting && state.moment >= 0")


def seen(page):
    settled(page)
    return np.array(Image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)


def box(page, name):
    """Slices of a screenshot that an element takes."""
    at = page.locator(name).bounding_box()
    x, y = round(at["x"]), round(at["y"])
    return slice(y, y + round(at["height"])), slice(x, x + round(at["width"]))


def test_the_page_decodes_what_python_packed(page, file):
    told = carried(file.read_text())
    for name in ("centre", "quaternion", "root", "place"):
        found = np.array(page.evaluate(f"Array.from(scene.{name}.values)"), dtype=float)
        np.testing.assert_array_equal(found, unpacked(told[name]).ravel())
    std = page.evaluate("Array.from(scene.std.values)")
    root = unpacked(told["root"]) * np.sqrt([1, 2, 2, 1, 2, 1])
    np.testing.assert_allclose(std, np.linalg.norm(root, axis=-1).ravel(), rtol=1e-12)


def test_points_of_a_body_may_lie_as_they_like(page):
    points, at = [0.0, 0.1, 0.4, 0.7], np.linspace(-0.1, 0.8, 19)
    found = page.evaluate(f"{at.tolist()}.map((s) => cellOf({points}, s))")
    place = [points[n] + share * (points[n + 1] - points[n]) for n, share in found]
    np.testing.assert_allclose(place, np.clip(at, 0.0, 0.7), atol=1e-12)


@pytest.mark.parametrize("moment", [0, 13])
def test_ellipsoids_have_the_axes_of_the_covariance(page, posterior, moment):
    scene = scene_of(posterior[0])
    for point in (0, 24, 48):
        found = page.evaluate(
            f"ellipsoid(bodyAt(scene, {moment})[{point}], scene.sigmas, [0, 0, 0], 40, 41).vertices"
        )
        off = np.reshape(found, (-1, 9))[:, :3] - scene.pose[moment, point, :3, 3]
        variance, axes = np.linalg.eigh(scene.root[moment, point] @ scene.root[moment, point])
        reach = np.abs(off @ axes).max(axis=0)
        np.testing.assert_allclose(reach, SIGMAS_95 * np.sqrt(variance), rtol=0.01, atol=2e-5)
        size = np.linalg.norm(off @ np.linalg.inv(scene.root[moment, point]), axis=1)
        np.testing.assert_allclose(size, SIGMAS_95, rtol=0.02)


@pytest.mark.parametrize("moment", [0, 13])
def test_the_tube_is_the_outline_of_the_ellipsoids_across_the_body(page, posterior, moment):
    scene = scene_of(posterior[0])
    found = page.evaluate(
        f"(() => {{ const body = bodyAt(scene, {moment});"
        "return sweep(body, body.map((at) => sectionOf(at, scene.sigmas)), body.map(() => [0,0,0]))"
        ".vertices; })()"
    )
    rings = np.reshape(found, (-1, 24, 9))[:, :, :3]
    pose = scene.pose[moment]
    ends, rings = rings[[0, -1]], rings[4:-4]  # four rings round off either end
    body = (rings - pose[:, None, :3, 3]) @ pose[:, :3, :3]
    cov = scene.root[moment] @ scene.root[moment]
    turn = pose[:, :3, :3]
    of_body = np.swapaxes(turn, -1, -2) @ cov @ turn
    assert np.abs(body[..., 2]).max() < 5e-5  # across the body
    weight = np.linalg.inv(of_body[:, :2, :2])
    squared = np.einsum("nai,nij,naj->na", body[..., :2], weight, body[..., :2])
    np.testing.assert_allclose(np.sqrt(squared), SIGMAS_95, rtol=0.02)
    reach = np.einsum("ni,nai->na", pose[[0, -1], :3, 2], ends - pose[[0, -1], None, :3, 3])
    along = SIGMAS_95 * np.sqrt(of_body[[0, -1], 2, 2])
    np.testing.assert_allclose(np.abs(reach), np.tile(along[:, None], 24), rtol=0.02, atol=2e-5)
    films, _ = confidence_tube(pose[None], of_body[None], SIGMAS_95)  # as a film draws it
    assert np.abs(rings - films[0, 5:-5]).max() < 5e-5


def test_the_slider_moves_the_robot_and_the_numbers(page, posterior):
    tips = []
    for time in (0.0, 0.55, 1.0):
        page.locator("#slider").fill(str(round(20 * time)))
        settled(page)
        tips.append(page.evaluate("bodyAt(scene, state.moment).at(-1).centre"))
        at = posterior[0].at(LENGTH, time)
        np.testing.assert_allclose(tips[-1], at.position, atol=2e-5)
        assert page.locator("#clock").inner_text() == f"{time:.2f} s of 1.00 s"
        assert f"± {1e3 * at.std_position:.1f} mm" in page.locator("#now").inner_text()
    assert np.linalg.norm(np.subtract(tips[0], tips[2])) > 0.02


@pytest.mark.slow
def test_pictures_of_two_times_differ_at_the_robot_and_nowhere_else(page):
    before = seen(page)
    again = seen(page)
    assert np.array_equal(before, again)  # the same moment is the same picture
    outline = [drawn_box(page)]
    page.locator("#stage").press("End")
    after = seen(page)
    outline.append(drawn_box(page))
    changed = np.any(before != after, axis=-1)
    rows, columns = box(page, "#stage")
    stage = changed[rows, columns]
    low = np.min(outline, axis=0)[0] - 40.0  # the names beside it move as well
    high = np.max(outline, axis=0)[1] + 90.0
    y, x = np.nonzero(stage)
    assert y.size > 500
    assert low[0] <= x.min() <= x.max() <= high[0]
    assert low[1] <= y.min() <= y.max() <= high[1]
    for still in ("header", "#legend", "fieldset", "footer", "#reset"):
        assert not changed[box(page, still)].any(), still
    for moving in ("#now", "#curve", "#heat", "#slider", "#clock"):
        assert changed[box(page, moving)].any(), moving


def drawn_box(page):
    """Corners (2, 2) in pixels of the stage, of the robot with its tube."""
    return page.evaluate(
        """(() => {
        const [w, h] = [of("stage").clientWidth, of("stage").clientHeight];
        const view = viewOf(state.camera, w, h);
        const { shells } = partsAt(bodyAt(scene, state.moment), state.moment);
        const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
        for (const { mesh } of shells) for (let i = 0; i < mesh.vertices.length; i += 9) {
          project(view, mesh.vertices.slice(i, i + 3), w, h).forEach((c, k) => {
            low[k] = Math.min(low[k], c); high[k] = Math.max(high[k], c); });
        }
        return [low, high]; })()"""
    )


@pytest.mark.slow
def test_boxes_take_away_what_they_name(page):
    whole = page.evaluate("partsAt(bodyAt(scene, 3), 3)")
    for name in ("tube", "ellipsoids", "sensors"):
        page.locator(f"input[name={name}]").uncheck()
    bare = page.evaluate("partsAt(bodyAt(scene, 3), 3)")
    assert (len(whole["shells"]), len(bare["shells"])) == (2, 0)
    assert len(bare["solid"]["indices"]) < len(whole["solid"]["indices"])
    page.locator("#wider").select_option("10")
    page.locator("input[name=tube]").check()
    (shell,) = page.evaluate("partsAt(bodyAt(scene, 3), 3)")["shells"]
    middle = [
        np.reshape(p["mesh"]["vertices"], (-1, 24, 9))[28, :, :3]
        for p in (whole["shells"][1], shell)
    ]
    radius = [np.linalg.norm(ring - ring.mean(axis=0), axis=1) for ring in middle]
    np.testing.assert_allclose(radius[1], 10.0 * radius[0], rtol=1e-9)


@pytest.mark.slow
def test_keys_play_step_and_turn_nothing_else(page):
    moment = "state.moment"
    for key, expected in [("End", 20), ("ArrowLeft", 19), ("Home", 0), ("ArrowRight", 1)]:
        page.keyboard.press(key)
        assert page.evaluate(moment) == expected
    page.keyboard.press("Space")
    assert page.locator("#play").inner_text() == "pause"
    wait_until(page, "state.moment === 20 && !state.playing")
    assert page.locator("#play").inner_text() == "play"
    half = page.evaluate("state.camera.half")
    page.keyboard.press("+")
    assert page.evaluate("state.camera.half") < half
    page.keyboard.press("r")
    settled(page)
    assert page.evaluate("state.camera.half") == pytest.approx(half)


def test_a_drag_turns_and_the_map_seeks(page):
    at = page.locator("#stage").bounding_box()
    x, y = at["x"] + at["width"] / 2, at["y"] + at["height"] / 2
    yaw = page.evaluate("state.camera.yaw")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 50, y, steps=3)
    page.mouse.up()
    assert page.evaluate("state.camera.yaw") == pytest.approx(yaw - 0.4)
    heat = page.locator("#heat").bounding_box()
    page.mouse.click(heat["x"] + 0.75 * heat["width"], heat["y"] + 20)
    assert page.evaluate("state.moment") == 15


@pytest.mark.slow
def test_two_fingers_zoom(browser, file):
    with opened(browser, file, has_touch=True) as page:
        touch = page.context.new_cdp_session(page)
        half = page.evaluate("state.camera.half")

        def fingers(kind, *xs):
            points = [{"x": x, "y": 250, "id": i} for i, x in enumerate(xs)]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        fingers("touchStart", 200, 300)
        for apart in (120, 160, 200):
            fingers("touchMove", 250 - apart / 2, 250 + apart / 2)
        fingers("touchEnd")
        assert page.evaluate("state.camera.half") == pytest.approx(0.5 * half, rel=0.05)


def test_the_scale_bar_is_as_long_as_it_says(page):
    view = page.evaluate("viewOf(state.camera, of('stage').clientWidth, of('stage').clientHeight)")
    size = page.locator("#stage").bounding_box()
    project = "([view, p, w, h]) => project(view, p, w, h)"
    pixels = [
        page.evaluate(project, [view, end.tolist(), size["width"], size["height"]])
        for end in (np.zeros(3), 0.1 * np.array(view["right"]))
    ]
    assert pixels[1][0] - pixels[0][0] == pytest.approx(0.1 / view["pixel"], rel=1e-6)


@pytest.mark.slow
def test_dark_is_dark_and_light_is_light(browser, file):
    means = []
    for scheme in ("light", "dark"):
        with opened(browser, file, color_scheme=scheme) as page:
            means.append(seen(page).mean())
    assert means[0] > 200
    assert means[1] < 70


def test_a_narrow_screen_scrolls_down_never_sideways(browser, file):
    with opened(browser, file, viewport={"width": 360, "height": 640}) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
        assert page.locator("#play").bounding_box()["y"] < 640  # reached without scrolling


@pytest.mark.slow
def test_without_webgl_the_page_says_so_and_still_tells_its_numbers(browser, file):
    script = (
        "const own = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
        "return kind === 'webgl2' ? null : own.call(this, kind, ...more); };"
    )
    with opened(browser, file, script) as page:
        assert "no WebGL 2" in page.locator("#sorry").inner_text()
        assert page.locator("#sorry").is_visible()
        assert "±" in page.locator("#now").inner_text()
