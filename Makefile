# preshape: two commands are enough.
#   make demo   sets up what running needs, takes a mug from a table and pours, in simulation
#   make test   sets everything up and runs all tests

SHELL := /bin/bash
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3; do \
	  $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
VENV ?= .venv
BIN := $(VENV)/bin
JOBS ?= 2
RUNTIME := $(VENV)/.runtime
STAMP := $(VENV)/.installed
OLD_MUJOCO := $(VENV)/mujoco-4.0.0
OUT ?= out
# Compiled modules are kept beside their sources: the tests start hundreds of interpreters.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo browser test lint format bench reproduce pictures dist docs fuzz harden mutants clean

help:
	@sed -n '1,/^$$/p' Makefile | sed 's/^# \{0,1\}//'
	@echo "  make lint | bench | reproduce | pictures | dist | docs | fuzz | harden | mutants | clean"

setup: $(STAMP)

# HASHES=1, as in CI: what is installed must have the hashes of constraints-hashed.txt.
$(STAMP): pyproject.toml constraints.txt constraints-hashed.txt | $(BIN)/python
	@echo "installing preshape, its packages and those of its tests into $(VENV) (2.1 GB, some minutes; nothing outside it) ..."
	@test -z "$(HASHES)" || $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps \
	  --require-hashes -r constraints-hashed.txt
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@ $(RUNTIME)

# What running needs, without the packages of the tests.
$(RUNTIME): pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing preshape and the packages that running needs into $(VENV) (1 GB, a minute or two; nothing outside it) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "preshape needs Python 3.11 or newer: install it, or say make PYTHON=/path/to/python"; exit 3; }
	@$(PYTHON) -m venv $(VENV) || { \
	  echo "no virtual environment could be made: on Debian, apt-get install python3-venv"; rm -rf $(VENV); exit 3; }

demo: $(RUNTIME)
	@$(call show,plan mug --task pour --verify --memory $(OUT)/demo/memory.sqlite --out $(OUT)/demo/mug)
	@$(call show,simulate $(OUT)/demo/mug/plan.json --out $(OUT)/demo/mug)
	@$(call show,plan hammer --task strike --memory $(OUT)/demo/memory.sqlite --out $(OUT)/demo/hammer)
	@echo; echo "Look at $(OUT)/demo/mug/run.gif and $(OUT)/demo/hammer/plan.png, then try:"
	@echo "  $(BIN)/preshape view $(OUT)/demo/mug/plan.json                  why this grasp, and steer it, in the browser"
	@echo "  $(BIN)/preshape plan FILE.stl --unit mm --task lift --hand leap   an object and a hand of yours"
show = echo; echo '$$ preshape $(1)'; $(BIN)/preshape $(1)

# The tests of the browser app need a browser; Debian's is installed where we may.
browser:
	@command -v chromium chromium-browser google-chrome >/dev/null || { \
	  echo "installing Debian's chromium on this machine, for the tests of the browser app ..."; \
	  SUDO=$$([ "$$(id -u)" = 0 ] || echo "sudo -n"); \
	  $$SUDO apt-get -qq update >/dev/null 2>&1; \
	  DEBIAN_FRONTEND=noninteractive $$SUDO apt-get -qq install -y chromium >/dev/null 2>&1 \
	    || echo "no browser could be installed: the app's tests will fail; install chromium, then make test"; }

# One test compares MuJoCo 4.0.0, which other packages need, with the version of constraints.txt.
$(OLD_MUJOCO): | $(STAMP)
	@echo "installing mujoco-core 4.0.0 into $@, for one test ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $@ mujoco-core==4.0.0 \
	  || { rm -rf $@; echo "MuJoCo 4.0.0 could not be installed: the test that compares with it will fail"; }

test: setup browser $(OLD_MUJOCO)
	@$(BIN)/python -m pytest -n $(JOBS) --dist worksteal $(ARGS)

lint: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

format: setup
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

bench: setup
	@$(BIN)/python -m benchmarks $(ARGS)

# Slow studies: each shows its progress, goes on where it was stopped, and writes to out/.
fuzz: setup
	@$(BIN)/python -c 'import atheris' 2>/dev/null || \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[fuzz]'
	@$(BIN)/python -m hardening.fuzz $(ARGS)

harden: setup
	@$(BIN)/python -m hardening.kill
	@for one in server load signals streams kernel_cache memories files odd_objects clutter; do \
	  echo "hardening.$$one"; $(BIN)/python -m hardening.$$one $(ARGS) || exit 1; done
	@$(BIN)/python -m hardening.grips $(OBJECTS)
	@test -z "$(OBJECTS)" || $(BIN)/python -m hardening.objects $(OBJECTS)

mutants: setup
	@$(BIN)/python -m hardening.mutants $(ARGS)

# The wheel and the source package, checked, and the wheel installed where nothing else is.
dist: setup
	@rm -rf dist build $(OUT)/fresh
	@mkdir -p $(OUT)
	@$(BIN)/python -m build --outdir dist . >$(OUT)/build.log 2>&1 || { cat $(OUT)/build.log; exit 1; }
	@$(BIN)/python -m twine --no-color check --strict dist/*
	@$(BIN)/python -m venv $(OUT)/fresh
	@$(OUT)/fresh/bin/pip install --quiet --disable-pip-version-check -c constraints.txt dist/*.whl
	@cd $(OUT)/fresh && bin/preshape plan mug --task lift --memory :memory: --json >plan.json && \
	  echo "the wheel, installed alone in $(OUT)/fresh, plans for a mug"
	@rm -rf build $(OUT)/fresh

# The documentation site; ARGS="--gallery 1" draws only the first plan of the gallery anew.
docs: setup
	@$(BIN)/python -c 'import sphinx, furo, myst_parser' 2>/dev/null || \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@$(BIN)/python docs/make_site.py --out $(OUT) $(ARGS)

reproduce: setup
	@$(BIN)/preshape reproduce --out reports/reproduce $(ARGS)

pictures: setup
	@$(BIN)/python -m docs.make_pictures

clean:
	rm -rf $(VENV) $(OUT) build dist src/*.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
