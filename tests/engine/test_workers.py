"""What worker processes must have in common with the process that hands out the rows."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.run import workers
from sppm_pipeline.engine.run.executors import WorkerOptions
from sppm_pipeline.engine.run.workers import announced, check_worker
from sppm_pipeline.errors import ConfigError, ResourceError


@pytest.fixture
def driver(tmp_path):
    workers._looked_at.cache_clear()
    plugins = load_plugins(["sppm_pipeline.engine.run.executors"], distributions=False)
    with announced(tmp_path / "run", WorkerOptions(cache=tmp_path / "cache"), plugins) as made:
        yield made
    assert not list(tmp_path.glob("*/*"))


def other(driver, **versions):
    return replace(driver, host="head", versions=tuple((dict(driver.versions) | versions).items()))


def test_the_same_program_in_the_same_folders_fits(driver):
    assert check_worker(driver) == []


def test_other_versions_are_refused_and_all_are_listed(driver):
    with pytest.raises(ConfigError, match="is not that of head: ") as caught:
        check_worker(replace(other(driver, numpy="0.9", python="2.7"), program="0123456789abcdef"))
    for text in ("instead of 0.9", "instead of 2.7", "instead of 0123456789ab"):
        assert text in caught.value.message
    assert caught.value.message.count(";") == 2


def test_plugins_count_as_well(driver):
    with pytest.raises(ConfigError, match=r"plugin sppm-nowhere not installed instead of 1\.0"):
        check_worker(other(driver, **{"plugin sppm-nowhere": "1.0"}))


def test_another_processor_is_a_warning_once(driver):
    elsewhere = other(driver, processor="abacus")
    assert [len(check_worker(elsewhere)) for _ in range(3)] == [1, 0, 0]


def test_another_processor_is_refused_where_it_must_be_the_same(driver):
    with pytest.raises(ConfigError, match="instead of abacus"):
        check_worker(replace(other(driver, processor="abacus"), same_processor=True))
    assert check_worker(replace(driver, same_processor=True)) == []


def test_a_folder_that_is_not_shared_is_named(driver, tmp_path):
    for token in driver.tokens:
        with pytest.raises(ResourceError, match="does not share the folder") as caught:
            check_worker(replace(driver, tokens=(driver.tokens[0], token + "-")))
        assert str(tmp_path) in caught.value.message
    with pytest.raises(ResourceError, match="does not share"):  # a folder of the same name
        check_worker(replace(driver, token="other"))
