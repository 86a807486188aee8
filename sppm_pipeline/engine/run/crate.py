"""A run as one ZIP archive: an RO-Crate of the configuration, its inputs and all results, which can be run again."""

from __future__ import annotations

import datetime
import hashlib
import io
import json
import mimetypes
import os
import re
import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import sppm_pipeline
from sppm_pipeline.engine.config.document import plain, read_yaml
from sppm_pipeline.engine.files import DISK, file_digest, files_in, put_into_place
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.engine.strict_json import json_text
from sppm_pipeline.errors import ResourceError, SppmError

# version 1.1, which the profile is made for, has no word for the digest of a file
CONTEXT = ["https://w3id.org/ro/crate/1.1/context", {"sha256": "http://schema.org/sha256"}]
PROFILE = "https://w3id.org/ro/wfrun/process/0.5"
PIPELINE = "pipeline.yaml"


def write_crate(target: Path, plan: Plan, folder: Path, record: Mapping[str, Any]) -> None:
    """Write the archive of a run that has ended.

    It holds ``pipeline.yaml`` (``sppm run pipeline.yaml`` in the unpacked archive gives the same bytes), the files it
    reads below ``inputs/``, the run directory below ``run/``, and ``ro-crate-metadata.json``, whose license, author
    and publisher are those of the key `notes` of the configuration: a name, or a map of name, url and affiliation.

    Raises
    ------
    ResourceError
        If it can't be written.
    """
    steps = [step for group in (plan.steps, plan.after, *plan.recipes.values()) for step in group]
    places = _places(plan, steps)
    document = _moved(plan.document, places) | {"folder": "."}
    files: dict[str, bytes | Path] = {PIPELINE: _yaml(document).encode()}
    for name, place in places.items():
        source = Path(name)
        files |= {f"{place}/{one}": source / one for one in files_in(source)} if source.is_dir() else {place: source}
    outputs = [f"run/{name}" for name in files_in(folder) if not PurePosixPath(name).name.startswith(".")]
    files |= {name: folder / name.removeprefix("run/") for name in outputs}
    described = {name: _file(name, content) for name, content in sorted(files.items())}
    files["ro-crate-metadata.json"] = json_text(_metadata(described, outputs, record, _notes(plan))).encode()
    half = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        with zipfile.ZipFile(half, "w") as archive:
            for name, content in sorted(files.items()):
                # the time of the archive is no part of the run
                entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                entry.external_attr, entry.compress_type = 0o644 << 16, zipfile.ZIP_DEFLATED
                with (
                    archive.open(entry, "w", force_zip64=True) as inside,
                    io.BytesIO(content) if isinstance(content, bytes) else content.open("rb") as file,
                ):
                    shutil.copyfileobj(file, inside)
        put_into_place(half, target, lambda: target)
    except OSError as error:
        half.unlink(missing_ok=True)
        raise ResourceError(f"can't write {str(target)!r}: {error.strerror}", hint=DISK) from error


def _places(plan: Plan, steps: Sequence[Step]) -> dict[str, str]:
    """Where each file or folder that the run reads lies in the archive."""
    read = [value for step in steps for value in vars(step.stage).values() if isinstance(value, Path)]
    named = [value for part in ("params", "sweep") for value in _strings(plan.document.get(part))]
    read += [Path(value) for value in named if os.path.isabs(value) and Path(value).is_file()]
    found: dict[str, str] = {}
    for folder, paths in (("inputs", read), ("plugins", plan.configuration.plugins)):
        for path in map(os.path.abspath, paths):
            if os.path.exists(path) and path not in found:
                place, number = f"{folder}/{os.path.basename(path)}", 1
                while place in found.values():
                    number += 1
                    place = f"{folder}/{number}/{os.path.basename(path)}"
                found[path] = place
    return found


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, (Mapping, list, tuple)):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _strings(one)


def _moved(value: Any, places: Mapping[str, str]) -> Any:
    if isinstance(value, Mapping):
        return {name: _moved(one, places) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_moved(one, places) for one in value]
    return places.get(value, value) if isinstance(value, str) else value


def _yaml(document: Mapping[str, Any]) -> str:
    from ruamel.yaml import YAML

    text, yaml = io.StringIO(), YAML()
    yaml.width = 120
    yaml.dump(json.loads(json_text(document)), text)
    return text.getvalue()


def _file(name: str, content: bytes | Path) -> dict[str, Any]:
    if isinstance(content, bytes):
        digest, size = hashlib.sha256(content).hexdigest(), len(content)
    else:
        digest, size = file_digest(content)
    kind = "application/yaml" if name.endswith(".yaml") else mimetypes.guess_type(name)[0] or "application/octet-stream"
    about = {"name": PurePosixPath(name).name, "encodingFormat": kind, "contentSize": str(size), "sha256": digest}
    return {"@id": quote(name), "@type": "File"} | about


def _notes(plan: Plan) -> Mapping[str, Any]:
    """The key `notes` of the configuration file; empty for a configuration without one, or that is in no file."""
    try:
        found = plain(read_yaml(plan.configuration.file)).get("notes")
    except SppmError:
        return {}
    return found or {}


def _metadata(
    files: Mapping[str, dict[str, Any]], outputs: Sequence[str], record: Mapping[str, Any], notes: Mapping[str, Any]
) -> dict[str, Any]:
    """The graph of the crate: its files, and the run that took some and made others."""
    began = datetime.datetime.fromisoformat(record["started"])
    ended = (began + datetime.timedelta(seconds=record["seconds"])).isoformat(timespec="seconds")
    program = f"https://pypi.org/project/sppm-pipeline/{sppm_pipeline.__version__}/"

    def references(names: Sequence[str]) -> list[dict[str, str]] | dict[str, str]:
        found = [{"@id": quote(name)} for name in names]
        return found[0] if len(found) == 1 else found  # as the specification writes a single value

    license = str(notes.get("license") or "Not stated: ask the author before you use it.")
    if re.fullmatch(r"[A-Za-z0-9.+-]+", license):
        license_id = f"https://spdx.org/licenses/{license}"
    else:
        license_id = license if re.match("https?://", license) else "#license"
    people = {role: _party(role, notes[role]) for role in ("author", "publisher") if notes.get(role)}

    graph: list[dict[str, Any]] = [
        {
            "@id": "ro-crate-metadata.json", "@type": "CreativeWork", "about": {"@id": "./"},
            "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
        },
        {
            "@id": "./", "@type": "Dataset", "name": record["name"], "datePublished": ended,
            "description": f"A run of sppm_pipeline {sppm_pipeline.__version__}. "
            f"`sppm run {PIPELINE}` in this folder repeats it.",
            "license": {"@id": license_id}, **{role: {"@id": found[0]["@id"]} for role, found in people.items()},
            "conformsTo": {"@id": PROFILE}, "hasPart": references(list(files)), "mentions": {"@id": "#run"},
        },
        {"@id": license_id, "@type": "CreativeWork", "name": license, "description": "the license of this crate"},
        {"@id": PROFILE, "@type": "CreativeWork", "name": "Process Run Crate", "version": "0.5"},
        {
            "@id": "#run", "@type": "CreateAction", "name": f"run of {record['name']}, seed {record['seed']}",
            "instrument": {"@id": program}, "object": references([name for name in files if name not in outputs]),
            "result": references(outputs), "startTime": record["started"], "endTime": ended,
            "description": f"threads: {record['threads']}; status: {record['status']}",
            "actionStatus": f"http://schema.org/{'Completed' if record['status'] == 'done' else 'Failed'}ActionStatus",
        },
        {
            "@id": program, "@type": "SoftwareApplication", "name": "sppm_pipeline", "url": program,
            "version": sppm_pipeline.__version__,
            "softwareRequirements": ", ".join(f"{name} {version}" for name, version in record["versions"].items()),
        },
    ]  # fmt: skip
    if "author" in people:
        graph[4]["agent"] = graph[1]["author"]
    named = {one["@id"]: one for found in people.values() for one in found}
    return {"@context": CONTEXT, "@graph": graph + list(named.values()) + list(files.values())}


def _party(role: str, value: Any) -> list[dict[str, Any]]:
    """A person or an organization of the notes, by its name or as a map, and the organization that it belongs to."""
    about = dict(value) if isinstance(value, Mapping) else {"name": str(value)}
    others = _party("affiliation", about["affiliation"]) if about.get("affiliation") else []
    if others:
        about["affiliation"] = {"@id": others[0]["@id"]}
    kind = "Person" if role == "author" else "Organization"
    return [{"@id": str(about.get("url", f"#{role}")), "@type": kind} | about, *others]
