"""What the studio makes of a configuration: controls from declarations, the same cell as the command line, errors."""

import contextlib
import http.client
import json
import math
import socket
import struct
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urlencode

import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.api.pipeline import Pipeline
from sppm_pipeline.engine.config.document import MAX_DEPTH
from sppm_pipeline.engine.files import write_whole
from sppm_pipeline.engine.plan.session import RunRequest
from sppm_pipeline.engine.process import interruption
from sppm_pipeline.engine.run.context import RunContext, StageLog
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.errors import ConfigError, InputError, PluginError, SppmError
from sppm_pipeline.features.browser.live.views import view_of
from sppm_pipeline.features.browser.studio.controls import _number, _slider
from sppm_pipeline.features.browser.studio.design import START, Design, Superseded
from sppm_pipeline.features.browser.studio.server import server_of
from sppm_pipeline.nouns.size import ONE
from sppm_pipeline.stage import OptionSpec

EXAMPLES = Path(__file__).parents[3] / "examples"

RECIPE = """\
sppm: 1
seed: 3
params: {target: 0.6}
recipes:
  cell: {preset: paper, total: 24}   # the paper's
pipeline:
  - {stage: read.primitive, shape: ball, size: [8 mm, 8 mm, 8 mm]}
  - {stage: tune.porosity, recipe: cell, target: "${target}", resolution: 16}
  - {stage: tile.periodic, cell: 4 mm}
  - {stage: fill.implicit}
"""


def design(text=START, file=None):
    return Design(RunRequest("cell.yaml", text=text, folder=".", distributions=False), file, 2)


@pytest.fixture(scope="module")
def started():
    return design()


def controls(made, target=None):
    return {control.key: control for control in made.controls[target or made.targets[0].name]}


def test_the_text_on_the_page_makes_the_same_kernels(started):
    changes = {"params.pores": 30, "pipeline.2.degree": [2, 4], "pipeline.1.gap": 0.02, "seed": 9}
    said, view = started.cell(changes, "field.gaussian")
    run = Pipeline.from_yaml(said["yaml"]).run(until="field.gaussian", cache=False)
    assert run["field.gaussian"].digest() == said["digest"]
    assert view_of(run["field.gaussian"]) == view
    assert started.cell({}, "field.gaussian")[0]["digest"] != said["digest"]


@pytest.mark.filterwarnings("ignore:.*changes the radii")  # which are of no concern here
def test_a_tuned_recipe_makes_the_same_kernels():
    made = design(RECIPE)
    assert made.targets[0].name == "tune.porosity"
    said, _ = made.cell({"recipes.cell.total": 20, "params.target": 0.55, "recipes.cell.omega": 25}, "tune.porosity")
    assert "cell: {preset: paper, omega: 25, total: 20}   # the paper's" in said["yaml"]
    run = Pipeline.from_yaml(said["yaml"]).run(until="tune.porosity", cache=False)
    assert run["tune.porosity"].digest() == said["digest"]
    assert said["porosity"] == pytest.approx(0.55, abs=0.02)


def test_everything_that_makes_a_field_can_be_shown():
    made = design(RECIPE)
    names = [target.name for target in made.targets]
    assert names == ["tune.porosity", "recipe cell", "tile.periodic", "fill.implicit"]
    assert made.cell({}, "recipe cell")[0]["numbers"]["pores"] == 24
    assert made.cell({}, "fill.implicit")[0]["porosity"] == pytest.approx(0.6, abs=0.1)
    assert made.numbers({}, "fill.implicit") == {}


def test_controls_are_the_declarations(started):
    found = controls(started)
    pores = found["params.pores"]
    assert (pores.label, pores.kind, pores.value, pores.slider) == ("pores", "integer", 95, (24, 380, 1))
    assert found["pipeline.2.degree"].value == [3, 5]
    assert found["pipeline.2.mode"].choices == ("exact", "greedy", "lp_fix")
    assert found["pipeline.3.pore_radius"].unit == "cell size"
    assert (
        found["pipeline.3.pore_radius"].help
        in Pipeline.from_yaml(START)
        ._session.registry.get("field.gaussian")
        .__dataclass_fields__["pore_radius"]
        .metadata["option"]
        .help
    )
    assert not found["pipeline.1.spacing"].written
    low, high, _ = found["pipeline.3.level"].slider
    assert 0 < low < high < 1
    assert not any(key.startswith("pipeline.6") for key in found)  # writes a file, after the cell


BOUNDS = [
    {}, {"minimum": -1e15, "maximum": 1e15}, {"above": 0.0}, {"minimum": 0.0, "maximum": 1.0},
    {"above": 0.0, "below": 1.0}, {"minimum": 1e-12, "maximum": 1e-3}, {"above": 0.3, "below": 0.7},
]  # fmt: skip
LISTS = [
    [-5.0], [-5.0, 2.0], [0.0], [3.0], [1e-6, 1.0], [2e-8], [3e-9], [4.7e-12], [0.31, 0.69], [0.5], [1.0], [1e-12],
    [1.7e9], [0.123456789012],
]  # fmt: skip


@pytest.mark.parametrize("bounds", BOUNDS, ids=str)
@pytest.mark.parametrize("whole", [False, True])
def test_sliders_hold_their_value_in_some_steps_within_bounds(bounds, whole):
    spec = OptionSpec("", **bounds)
    tried = 0
    for numbers in LISTS:
        if whole:
            numbers = sorted({float(round(number)) for number in numbers})
        good = all(
            bounds.get("minimum", -math.inf) <= n <= bounds.get("maximum", math.inf)
            and bounds.get("above", -math.inf) < n < bounds.get("below", math.inf)
            for n in numbers
        )
        if not good:
            continue
        tried += 1
        low, high, step = _slider(spec, numbers, whole)
        assert low <= min(numbers) <= max(numbers) <= high
        assert step > 0
        assert bounds.get("minimum", -math.inf) <= low
        assert bounds.get("maximum", math.inf) >= high
        assert bounds.get("above", -math.inf) < low
        assert bounds.get("below", math.inf) > high
        if whole:
            assert step == 1.0
            assert low == round(low)
            assert high == round(high)
        else:
            assert low == high or 5 <= (high - low) / step <= 500
    assert tried >= (not whole)


def test_a_slider_of_a_value_that_can_not_vary_has_no_range():
    assert _slider(OptionSpec("", minimum=2, maximum=2), [2.0], True) == (2.0, 2.0, 1.0)
    assert _slider(OptionSpec("", minimum=0.5, maximum=0.5), [0.5], False)[:2] == (0.5, 0.5)
    assert _number(".inf") is None
    assert _number(math.nan) is None
    assert _number("1e-9 mm") == 1e-9


def test_a_request_that_is_late_does_not_end_a_newer_one(started):
    older, newer = started._turn(), started._turn()

    def late():
        with contextlib.suppress(Superseded):
            older.__enter__()

    with newer:
        thread = threading.Thread(target=late)
        thread.start()
        thread.join(0.1)  # it waits for its turn
        assert not interruption.requested()
    thread.join()


def test_only_requests_of_the_same_page_end_each_other(started):
    other = design()
    with started._turn():
        reporting = RunContext(
            seed=1, path=("a",), address="a", threads=1, palette=ONE, log=StageLog(Monitor(), "a"), folder=None
        )
        other.cell({"params.pores": 12}, "")
        with other._turn():
            pass
        reporting.report(a=1)  # nobody has asked this one to end
        begun = started._turn()
        heard = []

        def report():
            try:
                reporting.report(a=2)
            except KeyboardInterrupt:
                heard.append(True)

        thread = threading.Thread(target=report)  # as threads of stages do
        thread.start()
        thread.join()
        assert heard == [True]
        assert interruption.requested()
    with begun:
        assert not interruption.requested()
    with pytest.raises(Superseded), started._turn():
        raise KeyboardInterrupt


def test_what_stops_the_program_stops_the_studio_and_stays(started):
    interruption.request()
    try:
        with pytest.raises(Superseded):
            started.cell({"params.pores": 13}, "")
        assert interruption.requested()
    finally:
        interruption.reset()


def test_options_of_a_plugin_have_controls():
    made = Design(RunRequest(str(EXAMPLES / "single_file_plugin.yaml")), None, 2)
    found = controls(made)
    assert found["pipeline.0.count"].slider == (10, 160, 1)
    assert found["pipeline.0.edge"].value == "5.0 mm"
    assert made.cell({"pipeline.0.count": 20}, "")[0]["numbers"]["pores"] == 20


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"params.pores": -3}, "params.pores", "at least 2"),
        ({"pipeline.1.spacing": "wide"}, "pipeline.1.spacing", "got 'wide'"),
        ({"pipeline.2.degree": [6, 4]}, "pipeline.2.stage", "wrong order"),
        ({"pipeline.1.spacing": 0.6}, "pipeline.1.stage", "do not fit"),
    ],
)
def test_errors_are_at_their_controls(started, changes, key, words):
    with pytest.raises(SppmError) as caught:
        started.cell(changes, "")
    faults = started.faults(caught.value, changes)
    assert faults[0]["key"] == key
    assert words in faults[0]["message"]


def test_only_controls_can_be_changed(started):
    with pytest.raises(ConfigError, match=r"'pipeline\.6\.path' can be changed"):
        started.cell({"pipeline.6.path": "/etc/passwd"}, "")


def test_a_configuration_without_a_field():
    with pytest.raises(ConfigError, match="makes a field"):
        design("sppm: 1\npipeline:\n  - {stage: read.primitive, shape: ball, size: [1 mm, 1 mm, 1 mm]}\n")


def test_a_newer_request_ends_the_older(started):
    made = design(RECIPE.replace("resolution: 16", "resolution: 16, fit_count: true, trials: 20"))
    ended = []

    def older():
        try:
            made.cell({}, "tune.porosity")
        except Superseded:
            ended.append(True)

    thread = threading.Thread(target=older)
    thread.start()
    while not made._engine.locked() and thread.is_alive():
        pass
    said, _ = made.cell({"recipes.cell.total": 12}, "recipe cell")
    thread.join()
    assert ended == [True]
    assert said["numbers"]["pores"] == 12


def test_a_file_is_saved_when_asked_and_never_silently_replaced(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(START, encoding="utf-8")
    made = Design(RunRequest(str(file), distributions=False), file, 2)
    made.cell({"params.pores": 30}, "")
    assert file.read_text(encoding="utf-8") == START
    made.save({"params.pores": 30})
    assert file.read_text(encoding="utf-8") == START.replace("pores: 95", "pores: 30")
    made.save({"params.pores": 31})
    file.write_text("# by hand\n" + START, encoding="utf-8")
    with pytest.raises(InputError, match="by someone else"):
        made.save({"params.pores": 32})
    assert file.read_text(encoding="utf-8").startswith("# by hand")
    made.save({"params.pores": 32}, anyway=True)
    assert "pores: 32" in file.read_text(encoding="utf-8")
    with pytest.raises(InputError, match="not started with a file"):
        design().save({})


def test_saves_at_once_do_not_take_each_other_for_strangers(tmp_path, monkeypatch):
    file = tmp_path / "mine.yaml"
    file.write_text(START, encoding="utf-8")
    made = Design(RunRequest(str(file), distributions=False), file, 2)
    whole = write_whole

    def slow(path, text, **options):
        whole(path, text, **options)
        time.sleep(0.05)  # written, and not yet noted

    monkeypatch.setattr("sppm_pipeline.features.browser.studio.design.write_whole", slow)
    with ThreadPoolExecutor(4) as pool:
        written = list(pool.map(lambda pores: made.save({"params.pores": pores}), (20, 21, 22, 23)))
    assert file.read_text(encoding="utf-8") in written


# --- the server ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def server(started):
    with server_of(started) as made:
        threading.Thread(target=made.serve_forever, daemon=True).start()
        yield made
        made.shutdown()


def asked(server, path, method="GET", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=60)
    with contextlib.closing(connection):
        connection.request(method, path, body, headers={"Host": f"127.0.0.1:{server.server_port}", **headers})
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


def test_strangers_are_refused(server):
    page = f"/{server.token}/"
    assert asked(server, page)[0] == 200
    for path, headers in (
        ("/", {}), ("/x/", {}), (f"/{server.token[:-1]}/", {}), (page, {"Host": "evil.example"}),
        (page, {"Origin": "http://evil.example"}), (f"{page}cell?changes=%7B%7D", {"Host": "evil.example:80"}),
    ):  # fmt: skip
        assert asked(server, path, **headers)[0] == 403
    assert asked(server, "/save", "POST", b"{}")[0] == 403
    assert asked(server, f"{page}other")[0] == 404
    assert asked(server, f"{page}save", "POST", b"x" * 10, **{"Content-Length": "9999999999"})[0] == 413


def test_the_page_may_only_talk_to_its_server(server):
    _, headers, body = asked(server, f"/{server.token}/")
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert policy.endswith("; connect-src 'self'")
    assert "unsafe-inline" not in policy.split(";")[1]
    assert policy in body.decode().replace("&#39;", "'")
    assert headers["X-Frame-Options"] == "DENY"
    assert "Access-Control-Allow-Origin" not in headers
    assert server.token not in body.decode()


def test_a_cell_over_the_wire(server, started):
    query = urlencode({"changes": json.dumps({"params.pores": 30}), "target": "field.gaussian"})
    status, _, body = asked(server, f"/{server.token}/cell?{query}")
    length = struct.unpack("<I", body[:4])[0]
    said, (direct, view) = json.loads(body[4 : 4 + length]), started.cell({"params.pores": 30}, "")
    assert status == 200
    assert body[4 + length :] == view
    assert said["digest"] == direct["digest"]
    query = urlencode({"changes": json.dumps({"params.pores": 1})})
    status, _, body = asked(server, f"/{server.token}/cell?{query}")
    assert status == 422
    assert json.loads(body)["errors"][0]["key"] == "params.pores"
    status, _, body = asked(server, f"/{server.token}/save", "POST", b'{"changes": {}}')
    assert status == 422
    assert "not started with a file" in json.loads(body)["errors"][0]["message"]


def test_nonsense_over_the_wire_is_refused(server):
    for text in ("", "[]", "[" * (MAX_DEPTH * 1000), "{", "null"):
        assert asked(server, f"/{server.token}/cell?{urlencode({'changes': text})}"[:60_000])[0] == 400
    for path, headers in (
        (f"/{server.token}///[", {}), (f"/{server.token}/", {"Origin": "http://["}),
    ):  # fmt: skip
        assert asked(server, path, **headers)[0] == 400


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        (b'{"changes": [1]}', {}, 400),
        (b'{"anyway": true}', {}, 400),
        (b"[]", {}, 400),
        (b'{"changes": {"params.pores"', {}, 400),
        (rb'{"changes": {"params.pores": "\ud800"}}', {}, 422),
        (b'{"changes": {"params.pores": %s}}' % (b"[" * 500 + b"]" * 500), {}, 422),
        (b'{"changes": {}}', {"Content-Length": "40"}, 400),
        (b"{}", {"Content-Length": "1" * 5000}, 413),
        (b"{}", {"Content-Length": "-2"}, 411),
        (b"{}", {"Content-Length": "two"}, 411),
    ],
    ids=[
        "list",
        "none",
        "list alone",
        "cut short",
        "half a character",
        "deep",
        "shorter than stated",
        "long number",
        "negative",
        "word",
    ],
)
def test_a_broken_request_saves_nothing(tmp_path, body, headers, status, capsys):
    file = tmp_path / "mine.yaml"
    file.write_text(START, encoding="utf-8")
    made = Design(RunRequest(str(file), distributions=False), file, 2)
    made.save({"params.pores": 30})
    saved = file.read_text(encoding="utf-8")
    with server_of(made) as served:
        threading.Thread(target=served.serve_forever, daemon=True).start()
        with socket.create_connection(("127.0.0.1", served.server_port), timeout=30) as wire:
            lines = {"Host": "127.0.0.1", "Content-Length": str(len(body)), **headers}
            head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
            wire.sendall(f"POST /{served.token}/save HTTP/1.1\r\n{head}\r\n".encode() + body)
            wire.shutdown(socket.SHUT_WR)
            assert wire.recv(100).split()[1] == str(status).encode()
        served.shutdown()
    assert file.read_text(encoding="utf-8") == saved
    assert not capsys.readouterr().err


def test_a_saved_file_keeps_its_permissions_and_links(tmp_path):
    file, link, twin = (tmp_path / name for name in ("mine.yaml", "link.yaml", "twin.yaml"))
    file.write_text(START, encoding="utf-8")
    file.chmod(0o640)
    link.symlink_to(file)
    Design(RunRequest(str(link), distributions=False), link, 2).save({"params.pores": 30})
    assert link.is_symlink()
    assert "pores: 30" in file.read_text(encoding="utf-8")
    assert file.stat().st_mode & 0o777 == 0o640
    twin.hardlink_to(file)
    Design(RunRequest(str(file), distributions=False), file, 2).save({"params.pores": 31})
    assert "pores: 31" in twin.read_text(encoding="utf-8")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.yaml", "mine.yaml", "twin.yaml"]


def test_only_a_file_that_was_changed_may_be_replaced_all_the_same(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(START, encoding="utf-8")
    with server_of(Design(RunRequest(str(file), distributions=False), file, 2)) as made:
        threading.Thread(target=made.serve_forever, daemon=True).start()
        path = f"/{made.token}/save"
        assert asked(made, path, "POST", b'{"changes": {"pipeline.3.level": 2}}')[0] == 422
        file.write_text("# by hand\n" + START, encoding="utf-8")
        assert asked(made, path, "POST", b'{"changes": {}}')[0] == 409
        made.shutdown()
    assert file.read_text(encoding="utf-8").startswith("# by hand")


def test_mistakes_are_told_and_closed_connections_are_not(server, capsys):
    for error in (ConnectionResetError(), TimeoutError(), ValueError("a mistake")):
        try:
            raise error
        except Exception:
            server.handle_error(None, ("127.0.0.1", 1))
    told = capsys.readouterr().err
    assert "a mistake" in told
    assert "ConnectionReset" not in told


def test_plugins_find_designs_too(tmp_path):
    (tmp_path / "own.py").write_text(
        "from sppm_pipeline import find, hookimpl\n\n\ndef own(query, *, cell, count):\n"
        "    if cell == '1 mm':\n        raise KeyError('no cell')\n    return find(query, cell=cell, count=1)\n\n\n"
        "@hookimpl\ndef sppm_design_finders():\n    return {'own': own}\n",
        encoding="utf-8",
    )
    design = Design(
        RunRequest("cell.yaml", text=START, folder=".", distributions=False, plugins=(str(tmp_path / "own.py"),)),
        None,
        1,
    )
    query = "porosity = 0.7, E_relative > 0.1"
    expected = sppm.find(query, cell="4 mm", count=3)
    assert design.found(query, "4 mm", 3) == [*expected, expected[0]]
    with pytest.raises(PluginError, match="the finder 'own' raised KeyError"):
        design.found(query, "1 mm", 3)
    with pytest.raises(ConfigError, match="is no condition"):
        design.found("stiff", None, 3)
