# Two commands for a fresh machine with Python 3.11+, pip and make; no root rights are needed.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: quickstart test test-oldest clean

quickstart: $(VENV)/.installed  ## set up and run the main job; results are in runs/quickstart
	$(BIN)/sppm run configs/quickstart.yaml

test: $(VENV)/.installed-tests  ## set up and pass all checks and tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/python -m pytest -n auto --dist loadfile

test-oldest:  ## the tests with the oldest libraries that pyproject.toml allows; in an environment of its own
	$(PYTHON) -m venv $(VENV)-oldest
	$(VENV)-oldest/bin/pip install --quiet --constraint tests/oldest.txt --editable ".[test,images,volume]"
	$(VENV)-oldest/bin/python -m pytest -n auto --dist loadfile tests

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --editable .
	touch $@

$(VENV)/.installed-tests: pyproject.toml $(wildcard plugins/*/pyproject.toml)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --editable ".[test]" $(foreach plugin,$(wildcard plugins/*/pyproject.toml),--editable $(dir $(plugin)))
	touch $(VENV)/.installed $@

clean:
	rm -rf $(VENV) build dist *.egg-info runs
