"""How Sphinx makes a site of the Markdown pages: `make docs`.

The pages are written for a Git host; what a site needs beyond that is added here: the table of contents, pages for
the source files that links lead to, notebooks, and formulas without a script.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import get_lexer_for_filename
from pygments.lexers.special import TextLexer
from pygments.util import ClassNotFound
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.logging import getLogger

ROOT = Path(__file__).resolve().parents[1]

project = "sppm_pipeline"
copyright = "the sppm_pipeline authors"
extensions = ["myst_parser", "sphinx_copybutton"]
source_suffix = {".md": "markdown", ".ipynb": "markdown"}
exclude_patterns = ["pictures", "paper", "README.md"]
html_theme = "furo"
html_title = "sppm_pipeline"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"
pygments_style, pygments_dark_style = "a11y-high-contrast-light", "monokai"  # the first comes with the theme
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4


def add_contents(app: Sphinx, name: str, source: list[str]) -> None:
    """Turn a notebook into Markdown, and let the page that lists a folder be the parent of its pages in the menu.

    They stand in the order of its links; what it does not name comes last.
    """
    if Path(app.env.doc2path(name)).suffix == ".ipynb":
        source[0] = "\n\n".join(notebook(json.loads(source[0])))
    report = Path(app.outdir, "gallery", "reports", Path(name).name + ".html")
    if name.startswith("gallery/") and report.exists():
        link = f'<p><a href="reports/{report.name}">The report of this run</a>, with a live view of what has one</p>'
        source[0] = re.sub(r"(?m)^!\[.*$", lambda picture: f"{picture[0]}\n\n{link}", source[0], count=1)
    if name == "howto/design-a-cell" and Path(app.outdir, "studio.html").exists():
        link = '<p><a href="../studio.html">Try it here</a>: a page that draws such cells without a server</p>'
        source[0] = source[0].replace("\n\n", f"\n\n{link}\n\n", 1)
    if name.endswith("/README"):
        folder = name.removesuffix("README")
        there = {page.removeprefix(folder) for page in app.env.found_docs if page.startswith(folder)} - {"README"}
        linked = dict.fromkeys(re.findall(r"\]\(([\w/-]+)\.(?:md|ipynb)\)", source[0]))
        pages = [*(page for page in linked if page in there), *sorted(there - set(linked))]
        source[0] += "\n\n".join(["", "```{toctree}\n:hidden:", "\n".join(pages) + "\n```\n"])


def notebook(content: dict[str, Any]) -> Iterator[str]:
    """Cells and what they show, as Markdown: of several forms of a result the picture, else the text."""
    for cell in content["cells"]:
        text = "".join(cell["source"])
        yield text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```"
        for output in cell.get("outputs", ()):
            data = output.get("data", {"text/plain": output.get("text", "")})
            if "image/png" in data:
                yield f"![What the code above shows](data:image/png;base64,{''.join(data['image/png']).strip()})"
            elif output.get("name") != "stderr":
                yield f"```text\n{''.join(data['text/plain']).rstrip()}\n```"


def resolve_sources(app: Sphinx, doctree: nodes.document) -> None:
    """Let links to files and folders of the repository lead to pages that show them."""
    name = app.env.docname
    base = ROOT if name == "index" else (ROOT / "docs" / name).parent  # the front page is README.md
    for node in [*doctree.findall(addnodes.download_reference), *doctree.findall(addnodes.pending_xref)]:
        target = node.get("reftarget", "").partition("#")[0]
        page = node.get("refdomain") == "doc"  # named as a page, without its ending
        path = ((ROOT / "docs" / f"{target}.md") if page else base / target).resolve()
        if path == ROOT / "docs" / "README.md":
            address = app.builder.get_relative_uri(name, "index") + "#documentation"
        elif path.is_relative_to(ROOT / "docs") or not path.exists() or not path.is_relative_to(ROOT):
            continue
        else:
            SHOWN.add(path)
            address = app.builder.get_relative_uri(name, page_of(path))
        node.replace_self(nodes.reference("", "", *node.children, refuri=address, internal=True))


SHOWN: set[Path] = set()
"""Files and folders outside of `docs` that pages link to."""


def page_of(path: Path) -> str:
    """Name of the page that shows a file or a folder of the repository."""
    return "source/" + path.relative_to(ROOT).as_posix()


def source_pages(app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """A page for each file that is linked to, and for each such folder and the files in it."""
    files = {file for path in SHOWN if path.is_dir() for file in path.iterdir() if file.is_file()}
    for path in sorted(SHOWN | files):
        title = path.relative_to(ROOT).as_posix()
        if path.is_dir():
            rows = [file for file in sorted(path.iterdir()) if file in SHOWN | files]
            body = "".join(f'<li><a href="{path.name}/{f.name}.html"><code>{f.name}</code></a></li>' for f in rows)
            body = f"<ul>{body}</ul>"
        else:
            try:
                lexer = get_lexer_for_filename(path.name)
            except ClassNotFound:
                lexer = TextLexer()
            body = highlight(path.read_text(encoding="utf-8"), lexer, HtmlFormatter())
        body = f"<section><h1><code>{html.escape(title)}</code></h1>{body}</section>"
        yield page_of(path), {"title": title, "body": body, "toc": "", "display_toc": False, "parents": []}, "page.html"


def let_keys_scroll(
    app: Sphinx, name: str, template: str, context: dict[str, Any], tree: nodes.document | None
) -> None:
    """Let what may be wider than the page (code, tables, formulas) be reached and scrolled by keys."""
    context["body"] = re.sub(
        r'<(pre|div(?= class="(?:table-wrapper|math)))', r'<\1 tabindex="0"', context.get("body", "")
    )


def visit_math(self: Any, node: nodes.math | nodes.math_block) -> None:
    """Write a formula as MathML, which browsers typeset without a script."""
    block = isinstance(node, nodes.math_block)
    tag = "div" if block else "span"
    try:
        formula = tex2mathml(node.astext(), as_block=block)
    except MathError as error:
        getLogger(__name__).warning("%s", error, location=node)
        formula = html.escape(node.astext())
    self.body.append(f'<{tag} class="math">{formula}</{tag}>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", add_contents)
    app.connect("doctree-read", resolve_sources, priority=100)  # before downloads are collected
    app.connect("html-collect-pages", source_pages)
    app.connect("html-page-context", let_keys_scroll)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math, None))
