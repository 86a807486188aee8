"""The studio in Chromium: a slider gives a new cell, its text on the page, and errors where they belong."""

import time

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.api.pipeline import Pipeline
from sppm_pipeline.engine.plan.session import RunRequest
from sppm_pipeline.features.browser.studio.design import START, Design
from sppm_pipeline.features.browser.studio.server import CHARTED
from tests.features.browser.conftest import served, until

PlaywrightError = pytest.importorskip("playwright.sync_api").Error

pytestmark = pytest.mark.browser

WIDTH = 400


@pytest.fixture(scope="module")
def page(browser):
    design = Design(RunRequest("cell.yaml", text=START.replace("95", "30"), folder=".", distributions=False), None, 2)
    with served(design, browser, WIDTH) as made:
        until(made, "document.getElementById('status').dataset.drawn", "no first cell", 120)
        yield made


def moved(page, key, value):
    """The digest of the cell after a slider was moved."""
    before = page.evaluate("document.getElementById('status').dataset.drawn")
    slider = page.locator(f"[data-key='{key}'] [type=range]").first
    slider.evaluate("(s, v) => { s.value = v; s.dispatchEvent(new Event('input')); }", str(value))
    # the text must be that of the cell: an earlier request may be answered meanwhile
    drawn = (
        f"(d => d !== '{before}' && document.getElementById('yaml').dataset.digest === d && "
        f"document.getElementById('yaml').textContent.includes('{value}') && d)"
        "(document.getElementById('status').dataset.drawn)"
    )
    return until(page, drawn, "no new cell")


def test_a_slider_gives_a_cell_and_its_text(page):
    digest = moved(page, "params.pores", 24)
    text = page.inner_text("#yaml")
    assert "pores: 24" in text
    made = Pipeline.from_yaml(text + "\n").run(until="field.gaussian", cache=False)["field.gaussian"]
    assert made.digest() == digest
    assert page.inner_text("[data-number=pores]") == "24"
    assert float(page.inner_text("[data-number=porosity]").rstrip(" %")) == pytest.approx(
        100 * (1 - made.solid(64).mean()), abs=0.006
    )


def test_radii_are_shown_before_the_engine_answers(page):
    held = []
    page.route("**/cell?*", lambda route: held.append(route))  # no answer
    before = float(page.evaluate("document.getElementById('live-readout').dataset.porosity"))
    slider = page.locator("[data-instant=pore_radius] [type=range]")
    with page.expect_request("**/cell?*"):  # or it would be asked, and answered, after the route has gone
        slider.evaluate("s => { s.value = '0.14'; s.dispatchEvent(new Event('input')); }")
        shown = float(page.evaluate("document.getElementById('live-readout').dataset.porosity"))
    while not held:  # the request has been seen, but may not have reached the route
        page.wait_for_timeout(10)
    for route in held:  # Chromium lets them pass when the route goes, and 0.14 would be drawn before 0.141
        route.fulfill(status=200, body="")
    page.unroute("**/cell?*")
    digest = moved(page, "pipeline.3.pore_radius", 0.141)
    made = Pipeline.from_yaml(page.inner_text("#yaml") + "\n").run(until="field.gaussian", cache=False)[
        "field.gaussian"
    ]
    assert made.digest() == digest
    assert shown > before + 0.05
    assert shown == pytest.approx(1 - made.solid(40).mean(), abs=0.01)


def test_errors_are_shown_at_their_control(page):
    box = page.locator("[data-key='pipeline.2.degree'] .number").first
    box.fill("6")
    box.press("Enter")
    until(page, "!document.querySelector(\"[data-key='pipeline.2.degree'] .fault\").hidden", "no error")
    fault = page.inner_text("[data-key='pipeline.2.degree'] .fault")
    assert "the degree bounds [6, 5] are in the wrong order" in fault
    box.fill("3")
    box.press("Enter")
    until(page, "document.querySelector(\"[data-key='pipeline.2.degree'] .fault\").hidden", "the error stays")


def test_the_keyboard_moves_a_slider(page):
    before = page.evaluate("document.getElementById('status').dataset.drawn")
    page.locator("[data-key=seed] [type=range]").focus()
    page.keyboard.press("ArrowRight")
    until(page, f"document.getElementById('status').dataset.drawn !== '{before}'", "no new cell")
    assert "seed: 2" in page.inner_text("#yaml")


def test_numbers_come_after_a_pause(page):
    found = until(page, "(t => t !== '–' && t)(document.querySelector('[data-number=E]').textContent)", "no E", 120)
    assert len(found.split(",")) == 3


def test_the_file_can_be_downloaded(page):
    with page.expect_download() as download:
        page.click("#download")
    assert download.value.suggested_filename == "cell.yaml"
    assert download.value.path().read_text(encoding="utf-8").strip() == page.inner_text("#yaml").strip()


def test_the_atlas_is_a_chart(page):
    page.click("#find summary")
    count = until(page, "document.querySelectorAll('#chart .design').length", "no chart")
    expected = sppm.find("porosity = 0.7", cell="4 mm", count=CHARTED)
    assert count == len(expected)
    point = page.locator("#chart .design").nth(7)
    point.focus()
    said = page.inner_text("#found")
    assert said.startswith(f"{expected[7].family}, {expected[7].total} pores a cell: E_relative ")
    assert float(said.split("E_relative ")[1].split()[0]) == pytest.approx(
        expected[7].values["E_relative"][1], rel=0.006
    )
    across = [
        float(one)
        for one in page.evaluate("[...document.querySelectorAll('#chart .design')].map(c => c.cx.baseVal.value)")
    ]
    assert [*np.argsort(across)] == [*np.argsort([one.values["E_relative"][1] for one in expected])]
    page.fill("#conditions", "E_relative > 2")
    page.click("#find button")
    until(page, "!document.querySelector('#find form ~ .fault').hidden", "no error")
    assert "no design of the atlas meets all conditions" in page.inner_text("#find .fault")
    page.fill("#conditions", "porosity = 0.7")
    page.click("#find button")
    until(page, "document.querySelector('#find form ~ .fault').hidden", "the error stays")


def test_the_studio_is_usable(page, usable):
    usable(page, ["[data-key='params.pores'] [type=range]", "#live-cut"])


def test_nothing_else_is_asked_and_nothing_overflows(page):
    assert all(url.startswith((page.home, "blob:")) for url in page.asked)
    # refused values are answered with 422; software that draws in place of a graphics card tells of its slowness
    assert [words for words in page.heard if "422" not in words and "GL Driver Message" not in words] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= WIDTH
    assert page.evaluate("fetch('http://127.0.0.1:9/').then(() => 'fetched', () => 'refused')") == "refused"
    unlabeled = page.evaluate(
        "[...document.querySelectorAll('input, select')].filter(i => !i.labels.length && !i.ariaLabel).length"
    )
    assert unlabeled == 0


def test_a_point_of_the_chart_opens_its_cell(page):
    page.locator("#chart .design").nth(7).focus()
    page.keyboard.press("Enter")
    text = sppm.find("porosity = 0.7", cell="4 mm", count=CHARTED)[7].configuration("found")
    ends = time.monotonic() + 60
    while True:
        try:
            if page.inner_text("h1") == "found" and page.locator("#chart .design.taken").count():
                break
        except PlaywrightError:  # the page is being left
            pass
        assert time.monotonic() < ends, page.heard
        page.wait_for_timeout(50)
    until(page, "document.getElementById('status').dataset.drawn", "not drawn", 120)
    assert page.inner_text("#yaml").strip() == text.strip()
    assert page.inner_text("#found").startswith("open: ")
    for number in ("x", "9999"):
        status = page.evaluate(
            f"fetch('open?conditions=porosity%20%3D%200.7&number={number}', {{method: 'POST'}}).then(a => a.status)"
        )
        assert status == 422
