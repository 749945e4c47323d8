# Needs Python 3.11 or later, make, and a package index. Everything is installed into .venv here.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# an editable install says at length that folders here are named as packages are: they are meant to be
PIP    := PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet

.DEFAULT_GOAL := help
.PHONY: help render test test-long style types check wheel-check picture bench faults fuzz fuzz-scenes clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(PIP) --upgrade pip
	$(PIP) --editable '.[test]'
	@touch $@

$(VENV)/.dev: $(STAMP)
	$(PIP) --editable '.[test,dev]'
	@touch $@

render: $(STAMP) ## render a room with a mirror ball and a glass ball on a 2x2x2 array
	@mkdir -p out
	$(BIN)/raygrid render scenes/room.glb --array 2x2x2 --size 800x600 --samples 4 -o out/room.png
	@echo "the picture is out/room.png"

# two at a time; all tests of a file by one of them, since they share what is dear to make; in the order of
# tests/support/order.py, not by how many tests a file has
WORKERS ?= 2
PYTEST  := $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadfile --no-loadscope-reorder

test: $(STAMP) ## the tests, two files at a time: WORKERS=4 for four
	$(PYTEST) -m "not slow"

test-long: $(STAMP) ## all tests, the long ones too
	$(BIN)/python -m pytest

style: $(VENV)/.dev ## ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev ## mypy, over links that show the packages under their import names
	@mkdir -p build/types/raygrid
	@for layer in node emulator host; do ln -sfn ../../../$$layer build/types/raygrid/$$layer; done
	@ln -sfn ../../../host/facade/__init__.py build/types/raygrid/__init__.py
	cd build/types && ../../$(BIN)/mypy --config-file ../../pyproject.toml -p raygrid

# one after the other even under make -j, so that what is printed last is what failed first
check: ## style, types and tests: what .ci/run and every forge call
	@$(MAKE) --no-print-directory style
	@$(MAKE) --no-print-directory types
	@$(MAKE) --no-print-directory test

wheel-check: $(STAMP) ## build the wheel, install it into an empty environment, and use it there
	$(BIN)/python -m pytest tests/system/test_wheel.py

picture: $(STAMP) ## draw docs/architecture.svg, the packages and what they import
	$(BIN)/python docs/make_picture.py

bench: $(STAMP) ## measure speed and write docs/performance.md
	$(BIN)/python benchmarks/bench.py --write docs/performance.md

faults: $(STAMP) ## break arrays and services, and write docs/faults.md; 25 minutes
	$(BIN)/python benchmarks/faults.py --write docs/faults.md

fuzz: $(STAMP) ## send a million malformed messages into an array; some minutes
	$(BIN)/python benchmarks/fuzz.py

fuzz-scenes: $(STAMP) ## render 2,000 scenes of extreme numbers; half an hour
	$(BIN)/python benchmarks/fuzz_scenes.py

clean: ## remove what the other targets made
	rm -rf $(VENV) build out *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
