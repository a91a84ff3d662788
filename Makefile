# make demo   from nothing to a gallop in runs/demo; its video: the animal, the robot without the method, and with it
# make test   the quick tests, on all cores; PYTEST_ARGS="-x tests/control" runs some of them, --slow the slow ones too
# make test-skipped   installs all extras and runs what make test skipped
# make docs   the documentation site in build/site
# The virtual environment is made in .venv when it is first needed.

VENV ?= .venv
BIN := $(VENV)/bin
# Modules are compiled when they are first imported, not all of them here.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile
PYTEST_ARGS ?=
WORKERS ?= auto
DEMO_ARGS ?=
PYTHON ?= $(firstword $(foreach p,python3 python3.13 python3.12 python3.11,$(shell \
	$(p) -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && echo $(p))))

.PHONY: demo test test-skipped lint format types docs bench clean

demo: $(VENV)/.installed
	$(BIN)/fastmimic imitate gallop --out runs/demo $(DEMO_ARGS)

test: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal $(PYTEST_ARGS)

test-skipped: $(VENV)/.installed-all
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal --skipped $(PYTEST_ARGS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: $(VENV)/.installed-dev
	$(BIN)/mypy

docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --site-dir build/site

bench: $(VENV)/.installed
	$(BIN)/python benchmarks/rollout.py
	$(BIN)/python benchmarks/mpc.py
	$(BIN)/python benchmarks/imitate.py

clean:
	rm -rf $(VENV) build dist runs .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src tests -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/.made:
	@test -n "$(PYTHON)" || { echo "no Python 3.11 or newer found; name one: make PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --upgrade pip  # a recent one finds versions in half of the time
	touch $@

$(VENV)/.installed: pyproject.toml | $(VENV)/.made
	$(INSTALL) --editable .
	touch $@

$(VENV)/.installed-dev: pyproject.toml | $(VENV)/.made
	$(INSTALL) --editable '.[dev]'
	touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: $(VENV)/.installed-dev
	$(INSTALL) --editable '.[docs]'
	touch $@

# Torch without CUDA, where the index has such a build.
$(VENV)/.installed-all: $(VENV)/.installed-dev
	$(INSTALL) torch==2.13.0
	$(INSTALL) --editable '.[rl,ray,docs]' onnxruntime pandas
	touch $@ $(VENV)/.installed-docs
