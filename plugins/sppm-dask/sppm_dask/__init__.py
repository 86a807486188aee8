"""Sweeps on Dask, for sppm_pipeline."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

from sppm_pipeline import hookimpl

__all__ = ["sppm_executors"]


def _dask(workers: int, where: str) -> Executor:
    from sppm_dask.executor import DaskExecutor

    return DaskExecutor(workers, where)


@hookimpl
def sppm_executors() -> dict[str, Callable[[int, str], Executor]]:
    """Our executor, ``--executor dask[:WHERE]``; Dask is imported only when it is used."""
    return {"dask": _dask}
