"""`sppm.show`: the widget with its sliders in Python, and its script in Chromium against a model made here."""

import base64
import json
import time

import pytest

import sppm_pipeline as sppm
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.browser.live.page import ASSETS, live_page
from sppm_pipeline.features.browser.live.views import view_of


def cell(radius, count=12):
    pores = sppm.sample.dart_throwing(total=count, share=0.55, seed=1)
    return sppm.field.gaussian(pore_radius=radius, tunnel_radius=0.05)(sppm.connect.mst(pores, seed=1))


def test_sliders_call_python_and_errors_are_told():
    pytest.importorskip("anywidget", reason="the extra notebook is not installed")
    widget = sppm.show(cell, radius=(0.1, 0.2), count=(10, 40, 12))
    assert widget.sliders == [["radius", 0.1, 0.2, pytest.approx(0.15), 0], ["count", 10, 40, 12, 1]]
    assert widget.view == view_of(cell(widget.values["radius"]))
    widget.values = {"radius": 0.12, "count": 20.0}
    assert widget.view == view_of(cell(0.12, 20))
    widget.values = {"radius": 0.12, "count": 10**9}
    assert "expected an integer" in widget.message
    assert widget.view == view_of(cell(0.12, 20))
    assert sppm.show(cell(0.12)).sliders == []
    with pytest.raises(ConfigError, match="arguments of a function"):
        sppm.show(cell(0.12), radius=(0.1, 0.2))
    with pytest.raises(ConfigError, match="`radius` is"):
        sppm.show(cell, radius=(0.2, 0.1))


MODEL = """
const held = HELD, listeners = {};
held.view = new DataView(Uint8Array.from(atob(held.view), (c) => c.charCodeAt(0)).buffer);
window.model = {
  get: (name) => held[name], on: (name, act) => { listeners[name] = act; }, off: (name) => { delete listeners[name]; },
  set: (name, value) => { held[name] = value; },
  save_changes: () => { window.saved = { ...held, view: null, page: null }; },
};
window.changed = (view) => {
  held.view = new DataView(Uint8Array.from(atob(view), (c) => c.charCodeAt(0)).buffer);
  listeners["change:view"]();
};
widget.render({ model, el: document.body });
"""


@pytest.mark.browser
def test_the_script_tells_what_the_view_shows_and_takes_another(browser, tmp_path):
    first, second = (view_of(cell(radius)) for radius in (0.12, 0.17))
    held = {"view": base64.b64encode(first).decode(), "page": live_page(first, framed=True), "message": "",
            "sliders": [["radius", 0.1, 0.2, 0.12, 0]], "values": {"radius": 0.12}}  # fmt: skip
    script = (ASSETS / "notebook.js").read_text(encoding="utf-8").replace("export default", "const widget =")
    model = MODEL.replace("HELD", json.dumps(held).replace("<", "\\u003c"))
    page = browser.new_page(viewport={"width": 360, "height": 800})
    heard = []
    page.on("pageerror", lambda error: heard.append(str(error)))
    (tmp_path / "page.html").write_text(f"<!doctype html><body><script>{script}{model}</script>", encoding="utf-8")
    page.goto((tmp_path / "page.html").as_uri())

    def told(differs_from=None):
        ends = time.monotonic() + 40
        while (found := page.evaluate("window.saved?.porosity")) in (None, differs_from):
            assert time.monotonic() < ends
            time.sleep(0.05)
        return found

    porosity = told()
    assert porosity == pytest.approx(1 - cell(0.12).solid(64).mean(), abs=1e-6)
    page.evaluate("view => window.changed(view)", base64.b64encode(second).decode())
    assert told(differs_from=porosity) == pytest.approx(1 - cell(0.17).solid(64).mean(), abs=0.02)
    page.evaluate(
        "() => { const s = document.querySelector('input'); s.value = '0.15'; s.dispatchEvent(new Event('input')); }"
    )
    time.sleep(0.4)
    assert page.evaluate("window.saved.values") == {"radius": 0.15}
    assert heard == []
    page.close()
