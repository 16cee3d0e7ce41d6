# Each target makes .venv, installs what it needs and does its job. Needs make and Python 3.11 to 3.13.
#   make test PYTEST_ARGS="-k runner"     make venv PYTHON=/path/to/python3.12     make report OUT=/tmp/report

VENV        := .venv
BIN         := $(VENV)/bin
OUT         ?= report
PYTEST_ARGS ?= -n 2 --dist loadscope
BENCH_ARGS  ?=

# The first of these that runs (a pyenv shim may exist and yet fail) and is a supported version.
CANDIDATES := python3.13 python3.12 python3.11 python3 python
SUPPORTED  := import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info < (3, 14))
PYTHON     ?= $(shell for p in $(CANDIDATES); do \
                "$$p" -c '$(SUPPORTED)' >/dev/null 2>&1 && { echo "$$p"; break; }; done)

PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable

# One BLAS thread: processes and the kernel's threads are the parallelism.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help venv report test lint bench clean

help: ## print this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-8s %s\n", $$1, $$2 }' Makefile

venv: $(VENV)/.installed ## create .venv with the package in it (editable)
	@echo 'Ready. To use it: . $(BIN)/activate'

report: $(VENV)/.installed ## write the robustness report to report/
	$(ONE_THREAD) $(BIN)/camless report --out "$(OUT)"

test: $(VENV)/.installed-test ## run the tests (PYTEST_ARGS="..." replaces "-n 2 --dist loadscope")
	$(ONE_THREAD) $(BIN)/python -m pytest $(PYTEST_ARGS)

lint: $(VENV)/.installed-lint ## check style, format, types and import direction
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

bench: $(VENV)/.installed-bench ## time the plant beside general solvers (BENCH_ARGS="--json FILE")
	$(ONE_THREAD) $(BIN)/camless bench $(BENCH_ARGS)

clean: ## remove .venv, the report, caches and build products
	rm -rf $(VENV) report build dist *.egg-info .*_cache .hypothesis .coverage htmlcov
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps. Each is touched last, so that an interrupted install is done again,
# and is out of date as soon as pyproject.toml changes.
$(VENV)/.created:
	@"$(PYTHON)" -c '$(SUPPORTED)' >/dev/null 2>&1 || { \
	  echo 'No usable Python (PYTHON="$(PYTHON)"; looked for $(CANDIDATES)).' >&2; \
	  echo 'camless-ctrl needs Python 3.11, 3.12 or 3.13 with its venv module (Debian: python3-venv).' >&2; \
	  echo 'Install one, or name one: make venv PYTHON=/path/to/python3.12' >&2; exit 1; }
	@$(BIN)/python -c '$(SUPPORTED); import pip' >/dev/null 2>&1 || { \
	  echo 'Creating $(VENV) with $(PYTHON)'; "$(PYTHON)" -m venv --clear $(VENV); }
	@touch $@

$(VENV)/.installed: pyproject.toml $(VENV)/.created
	@echo 'Installing camless-ctrl (the first time takes a minute or two)'
	@$(PIP_INSTALL) .
	@touch $@

$(VENV)/.installed-%: pyproject.toml $(VENV)/.created
	@echo 'Installing camless-ctrl[$*] (the first time takes a minute or two)'
	@$(PIP_INSTALL) '.[$*]'
	@touch $@
