"""The studio without a server: its cells are those of the program, and its address holds the configuration."""

import re
from urllib.parse import quote, unquote

import numpy as np
import pytest

from sppm_pipeline.engine.api.pipeline import Pipeline
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.run.context import generator
from sppm_pipeline.errors import SppmError
from sppm_pipeline.features.browser.live.page import ASSETS
from sppm_pipeline.features.browser.studio import alone
from sppm_pipeline.features.browser.studio.controls import with_values
from sppm_pipeline.method.stages.tune_porosity import _points
from tests.features.browser.conftest import page_of, until

pytestmark = pytest.mark.browser

WIDTH, SAMPLES, FINER = 400, 24, 37


@pytest.fixture(scope="module")
def functions(browser):
    """A page in which the functions of the studio's cells can be called."""
    made = browser.new_page()
    for file in (ASSETS / "kernels.js", alone.__file__.replace("alone.py", "assets/cell.js")):
        made.add_script_tag(path=str(file))
    yield made
    made.close()


def designs():
    """Values of 20 files: few pores and many, loose and full, trees and dense graphs."""
    rng = np.random.default_rng(11)
    for number in range(20):
        pores, low = int(rng.integers(16, 50) if number % 5 else rng.integers(100, 180)), int(rng.integers(1, 4))
        radius = 0.49 / pores ** (1 / 3)
        yield {
            "seed": int(rng.integers(0, 10**9)), "params.pores": pores,
            "params.porosity": round(float(rng.uniform(0.5, 0.8)), 3),
            "recipes.cell.0.share": round(float(rng.uniform(0.3, 0.95)), 2),
            "recipes.cell.2.degree": [low, low + int(rng.integers(1, 3))],
            "recipes.cell.3.pore_radius": round(radius, 4), "recipes.cell.3.tunnel_radius": round(radius / 5, 4),
            "recipes.cell.3.level": round(float(rng.uniform(0.15, 0.4)), 3),
        }  # fmt: skip


def tunnels(centers, edges, shifts):
    """Ends of all tunnels, sorted."""
    ends = [np.concatenate([centers[i], np.add(centers[j], s)]) for (i, j), s in zip(edges, shifts, strict=True)]
    return np.array(sorted(map(tuple, np.round(ends, 12))))


@pytest.mark.filterwarnings("ignore:.*the level.*changes the radii")
def test_twenty_files_have_the_graph_and_the_porosity_of_the_program(functions):
    asked, made = [], []
    for values in designs():
        text = with_values(alone.START, values).replace(
            'target: "${porosity}"', f'target: "${{porosity}}", resolution: {SAMPLES}, tolerance: 0.2'
        )
        made.append(Pipeline.from_yaml(text).run(until="tune.porosity", cache=False)["tune.porosity"])
        asked.append({alone.ROLES[key]: value for key, value in values.items()})
    shown = functions.evaluate(
        """([cells, n, finer]) => cells.map((cell) => {
          const graph = graphOf(cell), kernels = kernelsOf(graph, cell);
          const level = levelFor(sumsOff(kernels, n), cell.porosity);
          return { ...graph, level, porosity: shareFrom(sumsOff(kernels, finer), level) };
        })""",
        [asked, SAMPLES, FINER],
    )
    for one, cell in zip(shown, made, strict=True):
        pores = cell.graph.pores
        assert np.allclose(sorted(one["centers"]), sorted(pores.centers.tolist()), rtol=0, atol=1e-12)
        there = tunnels(one["centers"], [e[:2] for e in one["edges"]], [e[2] for e in one["edges"]])
        wanted = tunnels(pores.centers, cell.graph.edges, cell.graph.shift)
        assert there.shape == wanted.shape
        assert np.allclose(there, wanted, rtol=0, atol=1e-11)
        # a level lies anywhere between two neighboring samples
        assert one["level"] == pytest.approx(cell.level, rel=2e-3)
        porosity = float((cell.sample(_points(cell, FINER)) >= 0).mean())
        assert one["porosity"] == pytest.approx(porosity, abs=1e-3)


def test_random_numbers_are_those_of_the_program(functions):
    for seed, path, key in ((0, ("a",), ()), (7, ("tune.porosity", "cell@0", "b"), (0, 12)), (2**53 - 1, (), (-3,))):
        shown = functions.evaluate(
            """([seed, path, key]) => {
              const rng = generator(seed, path, key), next = streamOf(rng.word());
              return [rng.random(), rng.permutation(9), rng.permutation(8), rng.random(), next() < 1];
            }""",
            [seed, list(path), list(key)],
        )
        rng = generator(seed, path, key)
        rng.integers(0, 2**64, dtype=np.uint64)
        wanted = [rng.random(), rng.permutation(9).tolist(), rng.permutation(8).tolist(), rng.random(), True]
        assert shown == wanted


@pytest.mark.parametrize(
    "values", [{"seed": 980737, "pores": 7, "share": 0.44, "degree": [2, 2]}, {"pores": 5, "share": 0.9}]
)
def test_what_the_program_refuses_is_refused(functions, values):
    cell = {"seed": 1, "degree": [3, 5], **values}
    keys = {role: key for key, role in alone.ROLES.items()}
    with pytest.raises(SppmError) as refused:
        Pipeline.from_yaml(with_values(alone.START, {keys[role]: value for role, value in cell.items()})).run(
            until="tune.porosity", cache=False
        )
    said = functions.evaluate("c => { try { graphOf(c); return ''; } catch (e) { return e.message; } }", cell)
    assert said
    assert said.split(":")[0] in str(refused.value)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("alone") / "docs" / "studio.html"
    assert main(["studio", "--static", str(path)]) == 0
    return path


SMALL = with_values(alone.START, {"params.pores": 24, "recipes.cell.3.pore_radius": 0.16, "params.porosity": 0.6})
DRAWN = "(s => s.drawn && !s.quick && s.drawn)(document.getElementById('status').dataset)"


@pytest.fixture(scope="module")
def page(browser, file):
    with page_of(browser, f"{file.as_uri()}#{quote(SMALL)}", WIDTH) as made:
        until(made, DRAWN, "no first cell", 60)
        yield made


def test_the_address_gives_the_cell_that_the_program_makes(page):
    assert page.inner_text("#yaml").strip() == SMALL.strip()
    made = Pipeline.from_yaml(SMALL).run(until="tune.porosity", cache=False)
    cell = made["tune.porosity"]
    assert page.inner_text("[data-number=tunnels]") == str(len(cell.graph.edges))
    assert float(page.inner_text("[data-number=level]")) == pytest.approx(cell.level, rel=1e-3)
    shown = float(page.inner_text("[data-number=porosity]").rstrip(" %")) / 100
    assert shown == pytest.approx(1 - float(cell.solid(64).mean()), abs=1e-3)


def test_a_slider_changes_the_text_and_the_address(page):
    slider = page.locator("[data-key='params.pores'] [type=range]")
    before = page.evaluate(DRAWN)
    slider.focus()
    slider.press("ArrowLeft")
    until(page, f"(d => d && d !== '{before}' && d)({DRAWN})", "no new cell")
    text = page.inner_text("#yaml")
    assert "pores: 23" in text
    assert unquote(page.url.split("#")[1]).strip() == text.strip()
    page.keyboard.press("Control+z")
    until(page, f"{DRAWN} === '{before}'", "not undone")


def test_an_edited_text_is_read_and_another_form_is_refused(page):
    edited = SMALL.replace("  pores: 24", "# fewer\n\n  pores:   21").replace("level: 0.25", "level: 0.3")
    page.evaluate("text => { location.hash = encodeURIComponent(text); }", edited)
    until(page, "document.getElementById('yaml').textContent.includes('pores: 21')", "not read")
    assert "level: 0.3}" in page.inner_text("#yaml")
    assert page.inner_text("[data-number=pores]") == "21"
    page.evaluate("location.hash = encodeURIComponent('sppm: 1\\npipeline: []\\n')")
    until(page, "!document.getElementById('refused').hidden", "not refused")
    assert "another form" in page.inner_text("#refused")
    page.evaluate("text => { location.hash = encodeURIComponent(text); }", SMALL)
    until(page, "document.getElementById('refused').hidden", "refused for good")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("recipes.cell.2.degree", "9", "wrong order"), ("recipes.cell.0.edge", "5 pt", 'as in "5 mm"'),
        ("params.pores", "2.5", "integers from 4 to 400"), ("recipes.cell.3.pore_radius", "0.9", "reach"),
    ],
)  # fmt: skip
def test_errors_are_shown_at_their_control(page, key, value, words):
    box = page.locator(f"[data-key='{key}'] .number").first
    before = box.input_value()
    box.fill(value)
    box.press("Enter")
    until(page, f"!document.querySelector(\"[data-key='{key}'] .fault\").hidden", "no error")
    assert words in page.inner_text(f"[data-key='{key}'] .fault")
    box.fill(before)
    box.press("Enter")
    until(page, f"document.querySelector(\"[data-key='{key}'] .fault\").hidden", "the error stays")


def test_the_page_is_usable(page, usable):
    usable(page, ["[data-key='params.pores'] [type=range]", "#live-cut"])


def test_it_holds_all_that_it_needs(page, file):
    text = file.read_text(encoding="utf-8")
    assert len(text.encode()) < 400_000
    assert not re.search(r"(?:src|href)=[\"'](?!data:|#)", text)
    assert {url.split("#")[0] for url in page.asked if not url.startswith(("blob:", "data:"))} == {file.as_uri()}
    assert [words for words in page.heard if "GL Driver Message" not in words] == []
    assert page.evaluate("fetch('http://127.0.0.1:9/').then(() => 'fetched', () => 'refused')") == "refused"
    assert page.evaluate("document.documentElement.scrollWidth") <= WIDTH


def test_a_static_page_takes_no_part(capsys):
    assert main(["studio", "part.stl", "--static", "page.html"]) != 0
    assert "--static writes a page for cells of one form" in capsys.readouterr().err
