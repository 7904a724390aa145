# Everything runs inside a virtual environment that make sets up itself: a bare machine needs GNU make and a Python.
# `make help` lists the targets.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.NOTPARALLEL:

PYTHON  ?=
VENV    ?= .venv
OUT     ?= results
SAMPLES ?= 100000
ROOMS   ?= kinematics singularities dynamics
SEED    ?= 0
JOBS    ?= $(shell getconf _NPROCESSORS_ONLN)

CANDIDATES := $(or $(PYTHON),python3.14 python3.13 python3.12 python3.11 python3.10 python3)
BIN        := $(VENV)/bin
PIP        := $(BIN)/python -m pip install --quiet --no-input --disable-pip-version-check --no-compile
# uv resolves and unpacks in a fifth of the time; where it cannot be had, or does not find what pip is set up to find, pip does it all
INSTALL     = { $(PIP) uv && $(BIN)/uv pip install --quiet --python $(BIN)/python --editable '.[$(1)]'; } 2>/dev/null || \
  $(PIP) --editable '.[$(1)]'
STAMP      := $(VENV)/.installed
DOCS_STAMP := $(VENV)/.installed-docs

# bytecode is kept, whatever the environment says: tests start a hundred programs, and each would compile all it imports
COMPILED := PYTHONDONTWRITEBYTECODE=

# exit status 0 where a Python suits the package
SUITS    := import sys; sys.exit(not (3, 10) <= sys.version_info[:2] < (3, 15))
# ... and where it can make a virtual environment
HAS_VENV := import ensurepip, venv
# ... and where the stubs of its newest numpy keep dtypes through arithmetic (numpy 2.2 is the last one for Python 3.10)
TYPED    := import sys; sys.exit(sys.version_info < (3, 11))

.PHONY: help test reproduce validate long mutants bench engines pictures docs clean

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/\1 \2/p' Makefile | while read -r name text; do printf '  make %-10s %s\n' "$$name" "$$text"; done
	@echo
	@echo "Variables: PYTHON (interpreter for a new environment), VENV, OUT (of reproduce), SAMPLES and JOBS (of validate), ROOMS and SEED (of mutants)."

test: $(STAMP) ## lint, types, import contracts, tests (five minutes on two cores)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	@# types are checked beside the tests: mypy is one process, and alone it leaves the other cores idle for a minute.
	@# Tests without pytest's rewriting of asserts, which each worker does anew; what fails is told by a second run, with it
	@mkdir -p build; types=; status=0; \
	if $(BIN)/python -c '$(TYPED)'; then $(BIN)/mypy --strict >build/mypy.txt 2>&1 & types=$$!; \
	  else echo "mypy --strict: left out, the newest numpy for Python 3.10 has types too coarse for it"; fi; \
	$(COMPILED) OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal --assert=plain \
	  || { $(COMPILED) $(BIN)/python -m pytest --last-failed --last-failed-no-failures none || true; status=1; }; \
	if [ -n "$$types" ]; then echo "$(BIN)/mypy --strict"; wait "$$types" || status=1; cat build/mypy.txt; fi; exit $$status

reproduce: $(STAMP) ## run the experiments of the thesis into OUT (default: results)
	$(BIN)/redundancy-pin reproduce --out "$(OUT)"

validate: $(STAMP) ## long cross-check of the two backends on SAMPLES random states
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/redundancy-pin validate --samples $(SAMPLES) --jobs $(JOBS)

long: $(STAMP) ## long lists of random cases, ten times as many examples, counts into docs/tables/counts.md (RESUME=1: go on)
	$(if $(RESUME),,rm -f build/promises.jsonl)
	@status=0; $(COMPILED) EXAMPLES=10 RESUME="$(RESUME)" OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
	  $(BIN)/python -m pytest -n auto -m "long or property" || status=$$?; \
	$(BIN)/python tests/support/promises.py; exit $$status

mutants: $(STAMP) ## change ROOMS at random places, by SEED, and print the changes that no test notices
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/mutation.py $(ROOMS) --seed $(SEED)

bench: $(STAMP) ## time it beside Pinocchio, MuJoCo and Exudyn into docs/tables/speed.md; published problems, stack of C into their pages
	mkdir -p build
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest benchmarks --benchmark-json=build/benchmarks.json
	$(BIN)/python benchmarks/table.py build/benchmarks.json
	$(BIN)/python tests/oracles/published_table.py
	$(BIN)/python benchmarks/stack.py

pictures: $(STAMP) ## draw the pictures of the pages into docs/pictures; those of the gallery by Chromium
	$(BIN)/python docs/pictures/draw.py
	$(BIN)/python docs/pictures/gallery.py

engines: $(STAMP) ## planned efforts in Exudyn and MuJoCo: every motion to 1e-5 m, and the tables of docs/tables/engines.md
	@$(BIN)/python -c 'import exudyn, mujoco' 2>/dev/null || \
	  $(BIN)/python -m pip install --quiet --no-input --disable-pip-version-check --editable '.[dev,engines]'
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -m engines -n auto tests/engines
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/oracles/engine_table.py

docs: $(DOCS_STAMP) ## build the documentation into build/docs; warnings are errors
	rm -rf build/docs build/doctrees
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx -q -W --keep-going -b html -d build/doctrees docs build/docs
	@echo "build/docs/index.html"

clean: ## remove the environment, build products and caches (not the results)
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis \
	  docs/reference/api/modules docs/reference/api/names.md docs/tutorials/notebooks
	find redundancy_pin tests benchmarks -type d -name __pycache__ -prune -exec rm -rf {} +

# An environment whose interpreter works and suits is kept (`make clean` to change PYTHON); any other is made anew.
$(STAMP): pyproject.toml
	@if ! $(BIN)/python -c '$(SUITS)' 2>/dev/null; then \
	  chosen=; lacks_venv=; \
	  for candidate in $(CANDIDATES); do \
	    "$$candidate" -c '$(SUITS)' 2>/dev/null || continue; \
	    if "$$candidate" -c '$(HAS_VENV)' 2>/dev/null; then chosen=$$candidate; break; fi; \
	    lacks_venv=$$candidate; \
	  done; \
	  if [ -z "$$chosen" ] && [ -n "$$lacks_venv" ]; then \
	    echo "error: $$lacks_venv cannot make virtual environments: it has no venv or ensurepip module." >&2; \
	    echo "Install them (Debian, Ubuntu: apt install python3-venv), or name another: make PYTHON=/path/to/python3" >&2; \
	    exit 1; \
	  elif [ -z "$$chosen" ]; then \
	    echo "error: no Python >= 3.10 and < 3.15 among: $(CANDIDATES)." >&2; \
	    for candidate in $(CANDIDATES); do \
	      version=$$("$$candidate" --version 2>/dev/null) && echo "  $$candidate is $$version" >&2 || true; \
	    done; \
	    echo "Install one, or name it: make PYTHON=/path/to/python3" >&2; \
	    exit 1; \
	  fi; \
	  echo "Making $(VENV) with $$("$$chosen" --version)"; \
	  "$$chosen" -m venv --clear $(VENV); \
	fi
	@echo "Installing redundancy_pin[dev] into $(VENV)"
	@$(call INSTALL,dev)
	@touch $@

$(DOCS_STAMP): $(STAMP)
	@echo "Installing redundancy_pin[docs] into $(VENV)"
	@$(call INSTALL,docs)
	@touch $@
