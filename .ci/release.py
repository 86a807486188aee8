"""What a release needs: the variables of project.toml, where they are written to, and what refuses a release."""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

_LINK = re.compile(r"(?P<picture>!?)\[(?P<text>(?:[^\[\]]|\[[^\]]*\])*)\]\((?P<target>[^()\s]+)\)")
_MARKED = re.compile(
    r"(?P<begin>(?:<!-- |# )\[(?P<name>\w+)\](?: -->)?\n)(?P<text>.*?)(?P<end>(?:<!-- |# )\[/(?P=name)\])", re.DOTALL
)
_DATE = r"\d{4}-\d\d-\d\d"
_RECIPE = (".ci/conda/recipe.yaml", 'version: "{}"\n')
MARKED = (
    "SECURITY.md",
    "CODE_OF_CONDUCT.md",
    "CITATION.cff",
    ".ci/conda/recipe.yaml",
    "docs/paper/paper.md",
    "sppm_pipeline/engine/cli/cite.py",
)
"""Files with marked blocks, which `written` fills."""


def settings(root: Path = ROOT) -> dict[str, Any]:
    """The variables."""
    return tomllib.loads((root / ".ci" / "project.toml").read_text(encoding="utf-8"))


def readme(text: str, known: Mapping[str, Any], version: str) -> str:
    """README.md for a package index: links lead to the repository, and are plain text as long as none is known."""

    def absolute(found: re.Match[str]) -> str:
        if re.match(r"[a-z][a-z0-9+.-]*:|#", found["target"]):
            return found[0]
        if not known["repository"]:
            return "" if found["picture"] else found["text"]
        path, _, anchor = found["target"].partition("#")
        pattern = known["picture" if found["picture"] else "file"]
        address = pattern.format(repository=known["repository"], version=version, path=path)
        return f"{found['picture']}[{found['text']}]({address}{'#' if anchor else ''}{anchor})"

    return _LINK.sub(absolute, text)


def urls(known: Mapping[str, Any], version: str) -> dict[str, str]:
    """``[project.urls]``; empty as long as the repository is not known."""
    if not (repository := known["repository"]):
        return {}
    named = {"Repository": repository, "Issues": f"{repository}/issues"}
    for name, path in (("Documentation", "docs/README.md"), ("Changelog", "CHANGELOG.md"), ("Security", "SECURITY.md")):
        named[name] = known["file"].format(repository=repository, version=version, path=path)
    return named | ({"Documentation": known["documentation"]} if known["documentation"] else {})


def _blocks(known: Mapping[str, Any], date: str) -> dict[str, str]:
    """Text of each marked block; `date` is that of the version in the changelog."""
    contact, repository = known["contact"], known["repository"]
    doi = known["paper_doi"] or (known["paper_arxiv"] and f"10.48550/arXiv.{known['paper_arxiv']}")
    missing = (
        "No address is known yet. It is the variable `contact` of `.ci/project.toml`; no release is made without it."
    )
    return {
        "contact": f"Contact: <{contact}>\n" if contact else f"{missing}\n",
        "links": f'repository-code: "{repository}"\nurl: "{known["documentation"] or repository}"\n'
        if repository
        else "",
        "date": f"date-released: {date}\n" if re.fullmatch(_DATE, date) else "",
        "paper": f"  doi: {doi}\n" if doi else "",
        "doi": f'PAPER_DOI = "{doi}"\n',
        "about": f"  repository: {repository}\n" if repository else "",
        "authors": _authors(known["authors"]),
        "disclosure": known["disclosure"].strip() + "\n"
        if known["disclosure"]
        else "To be stated by the authors: the variable `disclosure` of `.ci/project.toml`.\n",
    }


def _authors(authors: Sequence[Mapping[str, str]]) -> str:
    """The head of the article."""
    if not authors:
        return "authors: []\n"
    places = list(dict.fromkeys(one["affiliation"] for one in authors))
    lines = ["authors:"]
    for one in authors:
        place = places.index(one["affiliation"]) + 1
        lines += [f"  - name: {one['name']}", f"    orcid: {one['orcid']}", f"    affiliation: {place}"]
    lines += ["affiliations:"]
    for number, name in enumerate(places, 1):
        lines += [f"  - name: {name}", f"    index: {number}"]
    return "\n".join(lines) + "\n"


def written(root: Path = ROOT, known: Mapping[str, Any] | None = None) -> Iterator[tuple[Path, str]]:
    """Each file with marked blocks, and its text as the variables fill it."""
    blocks = _blocks(settings(root) if known is None else known, _date_of(root))
    for name in MARKED:
        text = (root / name).read_text(encoding="utf-8")
        yield root / name, _MARKED.sub(lambda found: found["begin"] + blocks[found["name"]] + found["end"], text)


def version_of(root: Path = ROOT) -> str:
    """The version in pyproject.toml."""
    return str(tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"])


def _date_of(root: Path) -> str:
    """The date of the version in the changelog, or what stands in its place."""
    text = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = re.search(rf"^## \[{re.escape(version_of(root))}\] - (.*)$", text, re.M)
    return heading[1] if heading else ""


def problems(root: Path = ROOT, tag: str | None = None) -> list[str]:
    """What keeps a release from being made."""
    known, version = settings(root), version_of(root)
    found = [f".ci/project.toml: {name} is empty" for name in known["needed"] if not known[name]]
    if known["repository"] and not re.fullmatch(r"https://\S+[^/\s]", known["repository"]):
        found.append(".ci/project.toml: repository is no https address, or ends with a slash")
    if known["contact"] and not re.fullmatch(r"(mailto:)?[^@\s<>]+@[^@\s<>]+\.[^@\s<>]+|https://\S+", known["contact"]):
        found.append(".ci/project.toml: contact is neither a mail address nor an https address")
    for path, text in written(root, known):
        if path.read_text(encoding="utf-8") != text:
            found.append(f"{path.relative_to(root)} is stale: run python .ci/release.py --write")
    for name, pattern in (
        ("sppm_pipeline/__init__.py", '__version__ = "{}"'),
        ("CITATION.cff", "version: {}\n"),
        _RECIPE,
    ):
        if pattern.format(version) not in (root / name).read_text(encoding="utf-8"):
            found.append(f"{name} names another version than {version}")
    if not re.fullmatch(_DATE, _date_of(root)):
        found.append(f"CHANGELOG.md has no dated section [{version}]")
    if tag is not None and tag != f"v{version}":
        found.append(f"the tag {tag} is not v{version}")
    return found


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the variables to where they are shown")
    parser.add_argument("--check", action="store_true", help="list what keeps a release from being made")
    parser.add_argument("--tag", help="the tag of the release")
    args = parser.parse_args()
    if args.write:
        for path, text in written():
            path.write_text(text, encoding="utf-8")
    found = problems(tag=args.tag) if args.check else []
    print("\n".join(found), file=sys.stderr)
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
