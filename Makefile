# One command each; all work in a fresh clone. The environment is made once and reused.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
OUT ?= out/demo
DIR ?= metrics geometry localisation
SEED ?= 1
HOURS ?= 8
SEEDS ?= 8101
CORE := $(VENV)/.installed-core
TEST_STAMP := $(VENV)/.installed-test
STAMP := $(VENV)/.installed
DEV_STAMP := $(VENV)/.installed-dev
DOCS_STAMP := $(VENV)/.installed-docs
COMPILED := $(VENV)/.compiled
# ROS comes as wheels, but for a shell in which a ROS installation has been sourced.
ROS := $(if $(AMENT_PREFIX_PATH),,ros)
COMMA := ,
KERNELS := $(VENV)/.kernels-localisation $(VENV)/.kernels-mapping
KERNEL_FILES := $(shell grep -rl --include='*.py' 'sfr_loc_map.jit' sfr_loc_map)
# uv installs in a quarter of the time of pip. It leaves the bytecode to the first import; where PYTHONDONTWRITEBYTECODE
# is set, each process would compile it again. Files that it links are mapped in larger parts, which counts as 35 MB more
# of memory.
UV := $(or $(shell command -v uv 2>/dev/null),$(BIN)/uv)
PIP := $(BIN)/pip install --quiet --disable-pip-version-check
define install
	@if [ ! -x $(UV) ]; then echo "uv is not installed: pip installs $(1)"; $(PIP) $(1); \
	else $(UV) pip install --quiet --link-mode copy --python $(BIN)/python $(1) \
		|| { echo "uv failed: pip installs $(1)"; $(PIP) $(1); }; fi
endef
export PYTHONDONTWRITEBYTECODE :=
TINY := --set terrain.coarseness=16 --set rocks.cover=0.01 --set rocks.smallest_m=0.2 --set drive.pairs=2 --set 'drive.segments=[straight 1]' \
	--set loc.width=48 --set loc.height=40 --set loc.focal_px=40 --set nav.width=48 --set nav.height=40 --set nav.focal_px=40
CORES := $(shell nproc 2>/dev/null || sysctl -n hw.ncpu)
# One process more than cores, because tests of nodes and commands wait for other processes. The tests of a file stay in
# one process, because they share what its fixtures make. The quick tests only compute: they take a process a core.
PARALLEL := -n $(shell expr $(CORES) + 1) --dist loadfile --no-loadscope-reorder
CAMPAIGN := PYTHONPATH=test $(BIN)/python -P -m campaigns

.PHONY: help demo sample test test-fast test-quick faults misbehaviour signals drivers soak example-candidate fuzz recordings random-faults history-power mutants record compare kernels nees suite-overhead lint types config format check docs docs-check figures screens traceability docs-test dist dist-test clean

help:  ## Show the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 14

demo:  ## Replay the sample bag through the three nodes, score it against limits, write the report
	@$(MAKE) --no-print-directory -j 3 $(STAMP) $(KERNELS)
	$(BIN)/sfr replay sample/sample.mcap --start truth --limits sample/limits.yaml --out $(OUT) --overwrite
	@echo
	@echo "sfr is $(abspath $(BIN)/sfr): run it by that path, or as sfr after: source $(BIN)/activate"
	@echo "next: $(BIN)/sfr init my_rover    # a configuration and limits for data of your own, with the commands that use them"

sample: $(DEV_STAMP)  ## Render the sample bag again
	rm -rf out/sample sample/sample.mcap
	$(BIN)/sfr simulate config/simulation/sample.yaml out/sample
	$(BIN)/sfr convert out/sample sample/sample.mcap --jpeg-quality 82 --compression zstd --truth-grid 0.0001220703125

test: $(COMPILED)  ## Run all tests; the slowest are listed at the end
	$(BIN)/python -m pytest $(PARALLEL) --durations=60 --durations-min=2

test-fast: $(COMPILED)  ## Run the tests that start no node and take less than about two seconds each, for daily work
	$(BIN)/python -m pytest $(PARALLEL) -m "not ros and not slow"

test-quick: $(TEST_STAMP)  ## Run the quick tests of some folders (DIR="metrics geometry localisation") without ROS, the sample and slow tests
	$(BIN)/python -m pytest -n $(CORES) --dist loadgroup -m "not ros and not slow and not sample" $(addprefix test/,$(DIR))

faults: $(STAMP)  ## Inject one fault after the other into the nodes (FAULTS=) and write the observations to out/faults.json
	$(CAMPAIGN) faults $(FAULTS)

misbehaviour: $(STAMP)  ## Run methods that misbehave, and print the table of docs/measured_methods.md (CASES="crash hang")
	$(CAMPAIGN) misbehaviour $(CASES)

signals: $(DEV_STAMP)  ## Send signals to every long command at random times (COUNT=100) and check that no result is lost and no process remains
	$(CAMPAIGN) signals $(or $(COUNT),100)

drivers: $(STAMP)  ## Localise from two cameras as drivers publish them: rates, sizes, raw images, encodings (about 15 minutes)
	$(CAMPAIGN) drivers

soak: $(STAMP)  ## Localise and map as fast as the nodes answer, and judge the growth of their memory (MINUTES=60)
	$(CAMPAIGN) soak $(or $(MINUTES),60)

example-candidate: $(STAMP)  ## Compile the example candidate in C and run it on the sample
	mkdir -p out/candidate
	$(CC) -std=c99 -Wall -Wextra -Wpedantic -O2 -fPIC -shared -I include -o out/candidate/libcandidate.so examples/c_candidate/candidate.c -lm
	$(BIN)/sfr localise sample/sample.mcap --start truth --method lib:out/candidate/libcandidate.so -o out/candidate/estimate.csv --stats out/candidate/stats.csv --overwrite
	$(BIN)/sfr score out/candidate/estimate.csv sample/sample.mcap --stats out/candidate/stats.csv

fuzz: $(COMPILED)  ## Feed 2000 mutated files to all readers (SEED=N) and keep the files that fail in out/fuzz
	$(CAMPAIGN) fuzz --seed $(SEED) $(ARGUMENTS)

recordings: $(COMPILED)  ## Process each kind of recording up to a verdict and list commands, times, errors and messages (ROWS=)
	$(CAMPAIGN) recordings $(ROWS)

random-faults: $(COMPILED)  ## Localise 100 drives with random faults and count the drives with silent errors (SEED=N)
	$(CAMPAIGN) random-faults 100 $(SEED) sample/sample.mcap

history-power: $(COMPILED)  ## Simulate 2000 histories of suites and count false alarms, detected changes and nights until detection (SEED=N)
	$(CAMPAIGN) history-power --seed $(SEED)

mutants: $(COMPILED)  ## Change one place of metrics, geometry, scores, suites, methods, localisation, maps or simulation at a time and check that a test fails (WORDS=)
	$(BIN)/python tools/mutants.py $(WORDS)

record: $(STAMP)  ## Record the outputs of localiser and mapper (RECORD=out/record.json SOURCES=sample/sample.mcap)
	mkdir -p out
	$(BIN)/python tools/compare.py record $(or $(RECORD),out/record.json) $(or $(SOURCES),sample/sample.mcap)

compare: $(STAMP)  ## Compare two records (BEFORE=out/before.json AFTER=out/record.json) and check that every output is bit-identical
	$(BIN)/python tools/compare.py compare $(or $(BEFORE),out/before.json) $(or $(AFTER),out/record.json)

kernels: $(CORE)  ## Compile all kernels as after an installation and list the time of each
	$(BIN)/python tools/kernel_times.py $(PARTS)

suite-overhead: $(COMPILED)  ## Measure what a suite adds to tasks of known length, and how long workers wait
	$(CAMPAIGN) suite-overhead

lint: $(DEV_STAMP)  ## Check style
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(DEV_STAMP)  ## Check types
	$(BIN)/mypy

config: $(DEV_STAMP)  ## Write the parameter files from the code
	$(BIN)/python -m sfr_loc_map.nodes.parameter_files config

format: $(DEV_STAMP)  ## Format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(DOCS_STAMP)  ## Build the documentation site as out/docs/index.html; warnings are errors
	$(BIN)/sphinx-build -q -W --keep-going -j auto docs out/docs

docs-check: docs $(DEV_STAMP)  ## Open every page of the site in a browser, at 1280 and 390 px, and search (requires chromium)
	PYTHONPATH=test $(BIN)/python tools/site_check.py

figures: $(DOCS_STAMP)  ## Draw the figures of the concept pages again
	$(BIN)/python docs/_figures/draw.py
	$(BIN)/python docs/_figures/mars.py

nees: $(DOCS_STAMP)  ## Compute the NEES of the motion by interval on twelve rendered drives from SEEDS on, and on KITTI=PATH (an hour at first)
	$(BIN)/python tools/nees.py --seeds $(SEEDS) --figure docs/images/concepts/nees_by_interval.svg $(if $(KITTI),--kitti $(KITTI))

screens: $(DEV_STAMP)  ## Film and photograph the pages of the suite for the site (requires chromium)
	PYTHONPATH=test $(BIN)/python docs/_figures/screens.py

traceability: $(BIN)/python  ## Write docs/traceability.md from the clauses and the markers of the tests
	$(BIN)/python docs/_ext/traceability.py

docs-test: $(DEV_STAMP)  ## Run every command of the tutorials (about ten minutes)
	$(BIN)/python tools/tutorial_runner.py

dist: $(BIN)/python  ## Build the source distribution, with the sample, and the wheel into dist/
	rm -rf build dist
	$(BIN)/pip install --quiet --disable-pip-version-check setuptools wheel
	$(BIN)/python -c "from setuptools import build_meta; build_meta.build_sdist('dist'); build_meta.build_wheel('dist')" > /dev/null
	@ls -sh dist

dist-test: dist  ## Install the wheel into a fresh environment and run it there, without the sources (PYTHON=python3.12)
	rm -rf out/dist-test
	$(PYTHON) -m venv out/dist-test/venv
	out/dist-test/venv/bin/pip install --quiet --disable-pip-version-check "$$(echo dist/*.whl)[sim]"
	cd out/dist-test && PATH=$(CURDIR)/out/dist-test/venv/bin:$$PATH && sfr --version \
		&& sfr simulate drive --workers 1 --set terrain.coarseness=4 --set rocks.smallest_m=0.1 --set panorama.enabled=false \
			--set drive.pairs=6 --set loc.width=256 --set loc.height=256 --set loc.focal_px=200 \
		&& sfr localise drive -o estimate.csv --start truth && sfr score estimate.csv drive --condition frames=3 | tee score.txt && ! grep -E '[1-9] lost' score.txt

check: lint types docs test  ## Check style, types and documentation, and run all tests, as continuous integration does

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	-[ -x $(UV) ] || $(PIP) 'uv<1'

# An editable installation: commands and tests run the files of this folder.
$(CORE): $(BIN)/python setup.py pyproject.toml sfr_loc_map/__init__.py
	$(call install,-e .)
	@touch $@

$(TEST_STAMP): $(CORE)
	$(call install,"sfr_loc_map[test]")
	@touch $@

$(STAMP): $(CORE)
	$(call install,"sfr_loc_map[$(if $(ROS),ros$(COMMA))live]")
	@touch $@

$(DEV_STAMP): $(STAMP)
	$(call install,"sfr_loc_map[$(if $(ROS),ros$(COMMA))sim$(COMMA)dev]")
	@touch $@

# The kernels need no ROS: they are compiled on two cores while its wheels are fetched.
$(VENV)/.kernels-localisation: $(CORE) $(KERNEL_FILES)
	$(BIN)/python -P -m sfr_loc_map.kernels localisation
	@touch $@

$(VENV)/.kernels-mapping: $(CORE) $(KERNEL_FILES)
	$(BIN)/python -P -m sfr_loc_map.kernels mapping terrain
	@touch $@

$(DOCS_STAMP): $(STAMP)
	$(call install,"sfr_loc_map[docs]")
	@touch $@

# The kernels of the tests; otherwise each test process compiles all of them.
$(COMPILED): $(DEV_STAMP) $(KERNEL_FILES)
	@$(MAKE) --no-print-directory -j 2 $(KERNELS)
	scratch=$$(mktemp -d) && $(BIN)/sfr simulate $$scratch/tiny --workers 1 $(TINY) && rm -r $$scratch
	@touch $@

clean:  ## Remove the environment and all generated files
	rm -rf $(VENV) out build install log *.egg-info
