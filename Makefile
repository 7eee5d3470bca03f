# `make demo` and `make test` do all the set-up themselves; they need make and Python 3.11 or newer (PYTHON=...).

PYTHON ?= python3
VENV ?= .venv
WORKERS ?= 2

BIN := $(VENV)/bin
# Workers, later runs and the programs that tests start share bytecode, also where the environment asks Python to
# write none.
export PYTHONDONTWRITEBYTECODE :=
# Tests of a file stay together, so that what they share is made once.
PYTEST := $(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal
# Bytecode is made when a module is first imported: most of what pip installs never is, and it takes half the time.
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet install --no-compile --editable
NEEDED := import sys; sys.exit(sys.version_info < (3, 11) and "undertow needs Python 3.11 or newer: make PYTHON=python3.12")

.PHONY: demo test test-all check-docs check-fuzz bench docs clean

demo: $(VENV)/.installed
	$(BIN)/undertow demo

test: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy --num-workers $(WORKERS)
	$(BIN)/lint-imports --no-logo
	$(PYTEST)

# Every test: those marked slow and those marked docs, too.
test-all: $(VENV)/.installed-dev
	$(PYTEST) -m ""

# Ten thousand damaged files: FUZZ="--seed 7 --count 500", FUZZ="--case 0:4711 --keep DIR".
check-fuzz: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.fuzz --jobs $(WORKERS) $(FUZZ)

bench: $(VENV)/.installed-bench
	$(BIN)/python -m benchmarks.speed --out docs/results.md

# The page of commands anew, then the site: open docs/_build/html/index.html.
docs: $(VENV)/.installed-docs
	$(BIN)/python docs/_ext/commands_page.py docs/cli.md
	$(BIN)/python -m sphinx -b html -q -W --keep-going docs docs/_build/html

# The site, where warnings are errors, then the tests marked docs: links lead somewhere, code on pages runs, pages say
# what the program does, benchmarks measure what they say.
check-docs: $(VENV)/.installed-docs $(VENV)/.installed-dev
	$(BIN)/python -m sphinx -b html -q -W --keep-going -E -d docs/_build/check docs docs/_build/html
	$(PYTEST) -m "docs and not slow"

# The stamps stand in the environment: when it is thrown away, so are they. A half-made one is made again.
$(VENV)/.installed: pyproject.toml | $(VENV)/.made
	$(PIP) .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(VENV)/.made
	$(PIP) ".[dev]"
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: pyproject.toml | $(VENV)/.made
	$(PIP) ".[docs]"
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-bench: pyproject.toml | $(VENV)/.made
	$(PIP) ".[bench]"
	@touch $@ $(VENV)/.installed

$(VENV)/.made:
	@$(PYTHON) -c '$(NEEDED)'
	$(PYTHON) -m venv --clear $(VENV) || { echo "Python lacks its venv module (Debian, Ubuntu: apt install python3-venv)"; exit 1; }
	@touch $@

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache demo-output docs/_build docs/catalogue.md
