# Needs Python 3.11 or later, make, and a package index. Everything is installed into .venv here.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# an editable install says at length that folders here are named as packages are: they are meant to be
PIP    := PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet

.DEFAULT_GOAL := help
.PHONY: help render test test-long test-switches style types check check-oldest check-newest check-bounds check-interpreted \
        check-versions wheel-check picture docs gallery bench faults fuzz fuzz-scenes clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 19

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(PIP) --upgrade pip
	$(PIP) --editable '.[test]'
	@touch $@

$(VENV)/.dev: $(STAMP)
	$(PIP) --editable '.[test,dev,docs]'
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

# each turns one fast path off (docs/doctor.md)
SWITCHES := RAYGRID_FAST_LOAD RAYGRID_NATIVE_LINKS RAYGRID_SIMD

test-switches: $(STAMP) ## the tests with each fast path off, one after the other; long
	@for switch in $(SWITCHES); do echo "$$switch=0"; env $$switch=0 $(PYTEST) -m "not slow" || exit 1; done

style: $(VENV)/.dev ## ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev ## mypy, over links that show the packages under their import names
	@mkdir -p build/types/raygrid
	@for layer in node emulator host; do ln -sfn ../../../$$layer build/types/raygrid/$$layer; done
	@for file in __init__ aio; do ln -sfn ../../../host/facade/$$file.py build/types/raygrid/$$file.py; done
	cd build/types && ../../$(BIN)/mypy --config-file ../../pyproject.toml -p raygrid

# one after the other even under make -j, so that what is printed last is what failed first
check: ## style, types and tests: what .ci/run and every forge call
	@$(MAKE) --no-print-directory style
	@$(MAKE) --no-print-directory types
	@$(MAKE) --no-print-directory test

# what shows if kernels compile, load and give the right bits, and links work, with other versions of the libraries
TELLING := tests/node tests/emulator/driver tests/emulator/processes/test_array.py tests/host/cli/test_doctor_facts.py \
           tests/system/test_same_bits.py tests/system/test_known_pictures.py tests/system/test_switches.py

check-oldest: ## a telling part of the tests with the oldest libraries that pyproject.toml allows, in build/oldest
	@$(MAKE) --no-print-directory check-versions OF=oldest CHOOSE='--constraint .ci/oldest.txt'

check-newest: ## the same with the newest, releases to come too, in build/newest
	@$(MAKE) --no-print-directory check-versions OF=newest CHOOSE='--pre --upgrade --upgrade-strategy eager'

# an environment in build/, by its name and what pip is told beside the project
define ENVIRONMENT
	$(PYTHON) -m venv build/$(1)
	PYTHONWARNINGS=ignore build/$(1)/bin/python -m pip install --quiet --upgrade pip
	PYTHONWARNINGS=ignore build/$(1)/bin/python -m pip install --quiet $(2) --editable '.[test]'
endef

check-versions:
	$(call ENVIRONMENT,$(OF),$(CHOOSE))
	build/$(OF)/bin/python -m pip list | grep -iE '^(numpy|numba|llvmlite|pyzmq|xxhash|msgpack) '
	RAYGRID_CACHE=$(CURDIR)/build/$(OF)/kernels $(subst $(BIN),build/$(OF)/bin,$(PYTEST)) -m "not slow" $(TELLING)

# indices that lie outside an array raise; kernels of their own, in build/bounds
CHECKED := NUMBA_BOUNDSCHECK=1 RAYGRID_CACHE=$(CURDIR)/build/bounds
SHARED  ?= $(or $(RAYGRID_SHARED),../shared)

check-bounds: $(STAMP) ## tests of kernels, and some pictures, with every index checked
	@mkdir -p out
	$(CHECKED) $(PYTEST) -m "not slow" tests/node/jit tests/node/geometry tests/node/protocol tests/node/tracing tests/node/runtime
	@for scene in scenes/room.glb scenes/lights.toml $(wildcard $(SHARED)/scenes/spd/balls_3.nff $(SHARED)/scenes/spd/gears_1.nff); do \
	    echo "$$scene" && $(CHECKED) $(BIN)/raygrid render "$$scene" --size 256x192 -q -o out/checked.png || exit 1; done

# in an environment of its own: numba imports coverage wherever it is installed
check-interpreted: ## tests without a compiler, and how much of the kernels they run, in build/interpreted
	$(call ENVIRONMENT,interpreted,'coverage>=7.6')
	build/interpreted/bin/python benchmarks/kernel_coverage.py --least 95

wheel-check: $(STAMP) ## build the wheel, install it into an empty environment, and use it there
	$(BIN)/python -m pytest tests/system/test_wheel.py

picture: $(STAMP) ## draw docs/architecture.svg, the packages and what they import
	$(BIN)/python docs/make_picture.py

docs: $(VENV)/.dev ## build the site, documents and reference, in build/site; a warning is an error
	$(BIN)/python docs/site/make_site.py

gallery: $(STAMP) ## render the pictures of docs/gallery.md, and write that page; minutes, as programs are compiled
	$(BIN)/python docs/make_gallery.py

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
