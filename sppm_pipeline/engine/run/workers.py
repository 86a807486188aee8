"""Requirements on a worker process of a sweep: the program, versions and folders of the process that hands out rows."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import secrets
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sppm_pipeline.engine.cache.identity import environment, installed_version, program_digest
from sppm_pipeline.engine.plan.plugins import Plugins
from sppm_pipeline.engine.run.outputs import staging_name
from sppm_pipeline.errors import ConfigError, ResourceError


@dataclass(frozen=True)
class Driver:
    """The process that hands out the rows.

    `program` is the digest of its source, `versions` those of Python, libraries, plugins and the kind of processor.
    Each of the files `tokens`, one in the run directory and one in the cache, holds `token`.
    """

    host: str
    program: str
    versions: tuple[tuple[str, str], ...]
    tokens: tuple[str, ...]
    token: str
    same_processor: bool = False


@contextlib.contextmanager
def announced(path: Path, cache: Path | None, plugins: Plugins, *, same_processor: bool = False) -> Iterator[Driver]:
    """This process as a driver, with its tokens in the run directory and in the cache for as long as rows run."""
    distributions = _distributions(plugins)
    tokens = [path / staging_name()]
    if cache is not None:  # the same sweep again takes the place of what a killed one has left there
        tokens.append(cache / f"driver-{hashlib.sha256(str(path).encode()).hexdigest()[:16]}")
    # tokens show that a worker sees the same folders, not others of the same name
    driver = Driver(
        host=socket.gethostname(),
        program=program_digest(),
        versions=tuple(_versions(distributions).items()),
        tokens=tuple(str(token) for token in tokens),
        token=secrets.token_hex(8),
        same_processor=same_processor,
    )
    try:
        for token in tokens:
            try:
                token.parent.mkdir(parents=True, exist_ok=True)
                token.write_text(driver.token, "ascii")
            except OSError as error:
                raise ResourceError(f"can't write into {str(token.parent)!r}: {error.strerror}") from error
        yield driver
    finally:
        for token in tokens:
            with contextlib.suppress(OSError):
                token.unlink()


def check_worker(driver: Driver) -> list[str]:
    """Check that this worker process gives the results that the driver's process would.

    Returns warnings, at the first call in a process only: another processor may compute other last digits.
    `ConfigError` lists what is another: the program, a library, a plugin, or where it must not be the processor;
    `ResourceError` if it does not see the driver's folders.
    """
    before = _looked_at.cache_info().misses
    warning = _looked_at(driver)
    return [warning] if warning and _looked_at.cache_info().misses > before else []


@functools.lru_cache(maxsize=1)
def _looked_at(driver: Driver) -> str:
    host = socket.gethostname()
    for token in map(Path, driver.tokens):
        try:
            seen = token.read_text("ascii")
        except OSError:
            seen = ""
        # a folder of that name may exist on the worker's machine, too
        if seen != driver.token:
            raise ResourceError(
                f"the worker on {host} does not share the folder {str(token.parent)!r} with {driver.host}",
                hint="choose a run directory with -o, and a cache with --cache, on a file system that all share",
            )
    wanted = dict(driver.versions)
    here = _versions(_distributions_named(wanted))
    other = [
        f"{name} {here.get(name, 'not installed')} instead of {version}"
        for name, version in wanted.items()
        if here.get(name) != version and (driver.same_processor or name != "processor")
    ]
    if program_digest() != driver.program:
        other.append(f"sppm_pipeline with the digest {program_digest()[:12]} instead of {driver.program[:12]}")
    if other:
        raise ConfigError(
            f"the worker on {host} is not that of {driver.host}: {'; '.join(other)}",
            hint="start the workers in the same environment, with the same plugins",
        )
    if here["processor"] == wanted["processor"]:
        return ""
    return f"the processor of {host} is not that of {driver.host}: last digits may differ"


_PLUGIN = "plugin "
"""Prefix of the names of plugins among the versions."""


def _versions(distributions: tuple[str, ...]) -> dict[str, str]:
    """Versions that results depend on besides the program."""
    plugins = {_PLUGIN + name: installed_version(name) or "not installed" for name in distributions}
    return environment(plugins=("sppm-pipeline", *distributions)) | plugins


def _distributions(plugins: Plugins) -> tuple[str, ...]:
    return tuple(sorted({plugin.distribution for plugin in plugins.plugins if plugin.distribution}))


def _distributions_named(versions: dict[str, str]) -> tuple[str, ...]:
    return tuple(name.removeprefix(_PLUGIN) for name in versions if name.startswith(_PLUGIN))
