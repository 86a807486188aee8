# Two commands for a fresh machine with Python 3.11+, pip and make; no root rights are needed.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Python compiles what it imports, a tenth
PIP_OPTIONS := --quiet --disable-pip-version-check --no-compile
# else each of the hundreds of processes that tests start compiles what it imports, and `sppm check` takes 1.6 s, not .4
unexport PYTHONDONTWRITEBYTECODE

.PHONY: quickstart test coverage test-oldest docs paper lock clean

quickstart: $(VENV)/.installed  ## set up and run the main job; results are in runs/quickstart
	@echo "== running configs/quickstart.yaml; the first run compiles for half a minute"
	$(BIN)/sppm run configs/quickstart.yaml
	@echo "== done: look at runs/quickstart/part.png, and at runs/quickstart/slices"

test: $(VENV)/.installed-tests  ## set up and pass all checks and tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@echo "== checking types, on one processor and for a minute, beside all that follows"
	@$(BIN)/mypy >$(VENV)/types.txt 2>&1 & types=$$!; \
	$(BIN)/lint-imports; imports=$$?; \
	$(BIN)/python -m pytest -qqq --collect-only >/dev/null; : what all processes import is compiled once; \
	$(BIN)/python -m pytest -n auto --dist loadfile; tests=$$?; \
	wait $$types; types=$$?; cat $(VENV)/types.txt; test $$imports -eq 0 -a $$tests -eq 0 -a $$types -eq 0

# tests fill all processors already, and more threads of BLAS than one wait by turning; test_determinism has four
test coverage test-oldest: export OPENBLAS_NUM_THREADS = 1

coverage: $(VENV)/.installed-tests  ## the share of lines that tests reach; TESTS="tests/method tests/engine" for some
	$(BIN)/pip install --quiet "coverage>=7.10"
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -n auto --dist loadfile $(TESTS)
	$(BIN)/coverage combine --quiet
	mkdir -p build
	$(BIN)/coverage json --quiet -o build/coverage.json
	$(BIN)/coverage report --sort=cover --skip-covered > build/coverage.txt
	$(BIN)/python .ci/badge.py build/coverage.json build/coverage.svg

test-oldest:  ## the tests with the oldest libraries that pyproject.toml allows; in an environment of its own
	$(PYTHON) -m venv $(VENV)-oldest
	$(VENV)-oldest/bin/pip install --quiet --constraint tests/oldest.txt --editable ".[test,images,volume]" \
		$(foreach plugin,$(wildcard plugins/*/pyproject.toml),--editable $(dir $(plugin)))
	$(VENV)-oldest/bin/python -m pytest -n auto --dist loadfile

docs: $(VENV)/.installed-docs  ## run the gallery and make a site of the documentation in build/site; warnings are errors
	$(BIN)/python docs/generate_gallery.py --reports build/site/gallery/reports
	$(BIN)/sppm studio --static build/site/studio.html
	$(BIN)/python -m sphinx -W --keep-going -q -E -d build/doctrees docs build/site

paper: $(VENV)/.installed-docs  ## run every figure and table of the paper and of the docs' results, and write their pages
	$(BIN)/python docs/generate_paper.py --run

lock:  ## write .ci/lock.txt: all that continuous integration installs, for all systems and versions, with hashes
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
		--extra test --extra images --extra volume --extra tables --extra docs pyproject.toml .ci/lock.in -o .ci/lock.txt

$(VENV)/.installed: pyproject.toml
	@echo "== making a virtual environment in $(VENV)"
	$(PYTHON) -m venv --without-pip $(VENV)  # unpacking and compiling the pip that comes with Python takes 3 s
	@echo "== installing pip, the program and its libraries there"
	$(PYTHON) -m pip --python $(BIN)/python install $(filter-out --quiet,$(PIP_OPTIONS)) pip --editable .
	touch $@

$(VENV)/.installed-tests: pyproject.toml $(wildcard plugins/*/pyproject.toml)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install $(PIP_OPTIONS) "setuptools>=68" "hatchling>=1.27" editables  # once for all that is built
	$(BIN)/pip install $(PIP_OPTIONS) --no-build-isolation --editable ".[test]" $(foreach plugin,$(wildcard plugins/*/pyproject.toml),--editable $(dir $(plugin)))
	touch $(VENV)/.installed $@

$(VENV)/.installed-docs: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --editable ".[docs,plot]" $(foreach plugin,structures crushing tetrahedra,--editable plugins/sppm-$(plugin))
	touch $(VENV)/.installed $@

clean:
	rm -rf $(VENV) build dist *.egg-info runs
