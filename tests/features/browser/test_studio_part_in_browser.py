"""The job of a bracket by mouse: a mesh is dropped, sliders are moved, numbers are read, files are taken along."""

import re

import pytest

from sppm_pipeline.engine.api.functions import make_function
from sppm_pipeline.engine.api.pipeline import Pipeline
from sppm_pipeline.engine.cli.new import design_text
from sppm_pipeline.engine.plan.session import RunRequest
from sppm_pipeline.features.browser.studio import parts
from sppm_pipeline.features.browser.studio.design import START
from sppm_pipeline.features.browser.studio.server import Studio
from tests.features.browser.conftest import served, until

pytest.importorskip("playwright.sync_api")
pytestmark = [pytest.mark.browser, pytest.mark.filterwarnings("ignore::UserWarning")]


@pytest.fixture(scope="module")
def bracket(tmp_path_factory):
    """A plate with a hole, as a mesh on the disk."""
    folder = tmp_path_factory.mktemp("cad")
    block = make_function("read.primitive")(shape="box", size=["14 mm", "7 mm", "9 mm"])
    drill = make_function("read.primitive")(shape="cylinder", size=["3 mm", "3 mm", "9 mm"])
    mesh = make_function("fill.combine")(block, drill, operation="difference", turn=[90, 0, 0], at=[["4 mm", 0, 0]])
    make_function("write.mesh")(mesh, path="bracket.stl", output=folder)
    return folder / "bracket.stl"


@pytest.fixture(scope="module")
def page(browser):
    def coarse(*args):  # sizes of one draw, so that the test is quick
        return design_text(*args).replace('strut: "${strut}"', 'strut: "${strut}", draws: 1, resolution: 40')

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(parts, "design_text", coarse)
        request = RunRequest("cell.yaml", text=START.replace("95", "20"), folder=".", distributions=False)
        with served(Studio(request, 2), browser, 400) as made:
            yield made


QUICK = "document.getElementById('status').dataset.quick"


def drag(page, selector, keys):
    """Move a slider as a hand does, so that the page hears all events."""
    page.locator(selector).first.focus()
    for key in keys:
        page.keyboard.press(key)


def test_the_job_of_a_bracket(page, bracket, tmp_path):
    page.set_input_files("#mesh", bracket)
    until(page, "document.querySelector('h1').textContent === 'bracket_infill'", "no part")
    until(page, f"{QUICK} !== undefined", "no preview")
    first = page.locator("#controls fieldset").first.locator("label")
    assert first.all_inner_texts()[:5] == ["struts", "pores", "cell size", "porosity of the infill", "skin thickness"]
    assert page.inner_text("#size").startswith("14 × 7 × 9 mm")
    assert page.inner_text("#live-scale").endswith(" mm")

    # a printer
    page.select_option("#printer", "prusa_sl1s")
    until(page, "document.getElementById('yaml').textContent.includes('write.sl1')", "no printer")
    until(page, f"{QUICK} !== undefined", "no preview")
    # struts by a slider; a preview comes first
    before = float(page.inner_text("[data-number=ml]").removeprefix("≈").split()[0])
    drag(page, "[data-role='design.sizes.strut'] [type=range]", ["ArrowRight"] * 10)
    strut = page.locator("[data-role='design.sizes.strut'] .number").first.input_value()
    # the preview of the last key, and not of one before
    until(page, f"{QUICK} && document.getElementById('yaml').textContent.includes('strut: {strut}')", "no preview")
    assert float(page.inner_text("[data-number=ml]").removeprefix("≈").split()[0]) > before

    # the cell size moves struts and pores together, and undo takes it back
    drag(page, "[data-link=cell] [type=range]", ["ArrowRight"] * 3)
    until(page, f"!document.getElementById('yaml').textContent.includes('strut: {strut}')", "the cell moves no struts")
    for _ in range(3):  # each key was a step
        page.click("#back")
    until(page, f"document.getElementById('yaml').textContent.includes('strut: {strut}')", "no undo")

    # what is exact, the stiffness, and what the print takes
    until(page, f"{QUICK} === ''", "no exact part")
    until(page, "document.getElementById('numbers').dataset.porosity", "no layers")
    assert "E_s" in page.inner_text("[data-number=E]")
    assert "mm²" in page.inner_text("[data-number=k]")
    assert page.inner_text("[data-number=g]").endswith(" g")
    assert page.inner_text("[data-number=h]").endswith((" min", " h"))
    assert "resin" in page.inner_text("[data-number=verdict]")

    with page.expect_download() as download:
        page.click("#download")
    text = download.value.path().read_text(encoding="utf-8")
    assert download.value.suggested_filename == "bracket_infill.yaml"
    with page.expect_download(timeout=120_000) as download:
        page.click("[data-file=stl]")
    (tmp_path / "part.stl").write_bytes(download.value.path().read_bytes())
    with page.expect_download(timeout=120_000) as download:
        page.click("[data-file=print]")
    assert download.value.suggested_filename == "bracket_infill.sl1"
    printed = download.value.path().read_bytes()

    # the same from the command line: to the digit, and the file to the byte
    (tmp_path / "bracket.stl").write_bytes(bracket.read_bytes())
    (tmp_path / "bracket_infill.yaml").write_text(text, encoding="utf-8")
    record = Pipeline.from_yaml(tmp_path / "bracket_infill.yaml").run(tmp_path / "run", cache=False).record
    summary = next(stage["summary"] for stage in record["stages"] if stage["stage"] == "write.sl1")
    shown = page.evaluate("({...document.getElementById('numbers').dataset})")
    assert float(shown["porosity"]) == summary["porosity"]
    assert float(shown["volume"]) == summary["solid_volume_mm3"]
    assert (tmp_path / "run" / "bracket_infill.sl1").read_bytes() == printed
    surface = make_function("read.mesh")(path=str(tmp_path / "part.stl"))
    assert surface.summary()["volume_mm3"] == pytest.approx(summary["solid_volume_mm3"], rel=0.05)


def test_a_design_beside_another(page):
    page.click("#keep")
    kept = page.inner_text("[data-number=struts]")
    assert page.inner_text("[data-a=struts]") == f"A: {kept}"
    drag(page, "[data-role='design.sizes.strut'] [type=range]", ["ArrowRight"] * 5)
    until(page, f"document.querySelector('[data-number=struts]').textContent !== '{kept}'", "no second design")
    assert page.is_visible("#other-canvas")
    drawn = "document.getElementById('other-canvas').toDataURL().length"
    until(page, f"{drawn} > 5000", "nothing is drawn of A", 30)
    page.click("#to-a")
    until(page, "document.querySelector('[data-number=struts]').textContent.replace('≈ ', '') !== ''", "no way back")
    assert page.inner_text("[data-a=struts]") == f"A: {kept}"


def test_a_file_that_is_no_mesh_is_refused_and_the_part_stays(page, tmp_path):
    (tmp_path / "song.mp3").write_bytes(b"no mesh")
    page.set_input_files("#mesh", tmp_path / "song.mp3")
    until(page, "document.getElementById('refused').textContent.includes('is no mesh')", "no message")
    drawn = page.evaluate("document.getElementById('status').dataset.drawn")
    drag(page, "[data-role='design.sizes.strut'] [type=range]", ["ArrowRight"])
    until(page, f"document.getElementById('status').dataset.drawn !== '{drawn}'", "nothing is drawn after it")
    assert page.is_visible("#refused")
    assert page.inner_text("h1") == "bracket_infill"


def test_nothing_else_is_asked_and_nothing_overflows(page):
    assert all(url.startswith((page.home, "blob:")) for url in page.asked)
    assert [words for words in page.heard if not re.search("409|422", words) and "GL Driver Message" not in words] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    unlabeled = "[...document.querySelectorAll('input, select')].filter(i => !i.labels.length && !i.ariaLabel).length"
    assert page.evaluate(unlabeled) == 0
