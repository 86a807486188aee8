"""A small run with everything a report shows, and pages in Chromium."""

import contextlib
import shutil
import threading
import time

import pytest

from sppm_pipeline.engine.config.parameters import Overrides
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.features.browser.studio.server import server_of

SMALL = """
sppm: 1
name: small
seed: 5
pipeline:
  - {stage: sample.mirrored_faces, count: 9, spacing: 0.2}
  - {stage: sample.dart_throwing, count: 12, spacing: 0.2}
  - {stage: connect.mbdst, degree: [2, 4], mode: greedy}
  - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}
  - {stage: read.primitive, shape: ball, size: [8 mm, 8 mm, 8 mm]}
  - {stage: tile.periodic, cell: 4 mm}
  - {stage: fill.implicit}
  - {stage: write.view, grid_samples: 150000}
  - {stage: slice.field, pixel: 0.125 mm}
  - {stage: write.png, path: slices}
  - {stage: write.picture, path: part.png, resolution: 24, image_size: [240, 160], annotate: false,
     background: transparent}
  - {stage: extract.marching_cubes, resolution: 24}
  - {stage: write.mesh, path: part.stl}
"""


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """The folder of a finished run; tests copy it before they change it."""
    home = tmp_path_factory.mktemp("small")
    (home / "small.yaml").write_text(SMALL, encoding="utf-8")
    session = open_session(RunRequest(str(home / "small.yaml"), distributions=False, overrides=Overrides()))
    run_plan(session.plan(), home / "run", threads=2)
    return home / "run"


@pytest.fixture
def copied(small_run, tmp_path):
    """A copy of the run that may be changed."""
    return shutil.copytree(small_run, tmp_path / "run", ignore=shutil.ignore_patterns("report.html"))


@contextlib.contextmanager
def page_of(browser, address, width):
    """An address in a page of a width, with all that it asks for and says."""
    made = browser.new_page(viewport={"width": width, "height": 800}, accept_downloads=True)
    made.heard, made.asked, made.home = [], [], address
    made.on("console", lambda message: made.heard.append(message.text))
    made.on("pageerror", lambda error: made.heard.append(str(error)))
    made.on("request", lambda request: made.asked.append(request.url))
    made.goto(address)
    yield made
    made.close()


@contextlib.contextmanager
def served(studio, browser, width):
    """The page of a studio, of a server of its own."""
    with server_of(studio) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with page_of(browser, server.address, width) as made:
            yield made
        server.shutdown()


def until(page, expression, what, seconds=120):
    """Wait for something to be true; `wait_for_function` is what the page's policy forbids."""
    from playwright.sync_api import Error

    ends = time.monotonic() + seconds
    while True:
        with contextlib.suppress(Error):  # while another page is loaded
            if found := page.evaluate(expression):
                return found
        assert time.monotonic() < ends, f"{what}: {page.inner_text('body')[:2000]}; {getattr(page, 'heard', '')}"
        time.sleep(0.05)


STOPS = """() => [...document.querySelectorAll('a[href], button, input, select, summary, [tabindex]')].filter(e =>
  e.tabIndex >= 0 && !e.disabled && e.checkVisibility({ visibilityProperty: true }) && e.getClientRects().length)"""
"""What can be seen and takes the focus."""

CONTRAST = """() => {
  const numbers = (text) => {
    const found = text.match(/[\\d.]+/g).map(Number), scale = text.startsWith('color(') ? 255 : 1;
    return [...found.slice(0, 3).map((v) => v * scale), found.length > 3 ? found[3] : 1];
  };
  const over = ([r, g, b, a], below) => [r, g, b].map((v, i) => v * a + below[i] * (1 - a));
  const light = (c) => c.map((v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = (e) => {
    if (!e) return matchMedia('(prefers-color-scheme: dark)').matches ? [18, 18, 18] : [255, 255, 255];
    return over(numbers(getComputedStyle(e).backgroundColor), ground(e.parentElement));
  };
  const faint = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  let seen = 0;
  while (walker.nextNode()) {
    const text = walker.currentNode.textContent.trim(), e = walker.currentNode.parentElement;
    const style = getComputedStyle(e), visible = e.checkVisibility({ opacityProperty: true, visibilityProperty: true });
    if (!text || !visible || e.closest('script, style, :disabled')) continue;
    if (e.closest('#live-frame')) continue;  // over a picture
    let opacity = 1;
    for (let up = e; up; up = up.parentElement) opacity *= Number(getComputedStyle(up).opacity);
    const back = ground(e), color = numbers(e.closest('svg') && e.tagName !== 'svg' ? style.fill : style.color);
    const [a, b] = [light(over([...color.slice(0, 3), color[3] * opacity], back)), light(back)];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    seen++;
    if (ratio < 4.5) faint.push(`${ratio.toFixed(2)}: ${text.slice(0, 40)}`);
  }
  return [seen, [...new Set(faint)]];
}"""
"""How many texts there are, and those whose colors have a contrast below 4.5 to 1 (WCAG 2.2, criterion 1.4.3)."""


@pytest.fixture(scope="session")
def usable():
    """Check that a page fits both sizes, can be read in both themes, and that the keyboard reaches all of it."""

    def check(page, sliders):
        before = page.viewport_size
        for width in (400, 1400):
            page.set_viewport_size({"width": width, "height": before["height"]})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            for theme in ("dark", "light"):
                page.emulate_media(color_scheme=theme)
                seen, faint = page.evaluate(CONTRAST)
                assert seen > 10
                assert faint == [], theme
        page.set_viewport_size(before)
        count = page.evaluate(f"({STOPS})().map((e, i) => {{ e.dataset.stop = i; }}).length")
        page.evaluate("document.activeElement.blur(); window.scrollTo(0, 0)")
        reached, plain = set(), []
        for _ in range(count + 3):  # the browser's own bar may be stopped at as well
            page.keyboard.press("Tab")
            stop, outlined = page.evaluate(
                "(e => [e.dataset.stop ?? '', getComputedStyle(e).outlineStyle !== 'none'])(document.activeElement)"
            )
            if stop:
                reached.add(int(stop))
                plain += [] if outlined else [stop]
        lost = page.evaluate(
            "r => [...document.querySelectorAll('[data-stop]')].filter(e => !r.includes(+e.dataset.stop))"
            ".map(e => e.outerHTML)",
            sorted(reached),
        )
        assert lost == []
        assert plain == []
        for selector in sliders:
            slider = page.locator(selector).first
            slider.focus()
            at = slider.input_value()
            slider.press("ArrowLeft")
            slider.press("ArrowLeft")
            moved = slider.input_value()
            slider.press("ArrowRight")
            assert float(moved) < float(slider.input_value()) <= float(at)
            slider.press("ArrowRight")

    return check
