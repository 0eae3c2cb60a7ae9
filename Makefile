# Each target does its own set-up: it makes .venv when it is missing or older than the locks. Nothing else is touched.
#
#   make demo    learn the backlash and judge four laws, on real ROS 2 in lockstep, recorded: results in results/demo
#   make live    a simulated drive, its controller and a page in the browser, which prints its address
#   make test    all tests
#   make faults  inject every fault and write docs/faults.md; make test-repeat does it twenty times under load
#   make bad-samples  what wrong samples do to the load, at the end of docs/faults.md
#   make lint    formatting, style, types, and links of the pages
#   make paper   the paper's figures and the page that judges them, in docs
#   make evaluation  2,000 random drives, judged, into docs/evaluation.md; on all cores
#   make docs    docs/parameters.md, the table of all parameters, from the code; and the picture of the dashboard, in Chromium
#   make site    the documentation as a site, in results/site
#   make bench   what a tick costs; how fast the offline loop is, beside scipy in the same run; six axes in real time; lockstep;
#                one axis while it identifies its drive, beside itself at rest;
#                one axis at 1 kHz, beside itself while ten pages of the dashboard read every sample;
#                a step of the node beside a bare publish;
#                a listener that is stopped, by shared memory and by UDP;
#                the plant beside the same equations in C and beside scipy, and batches of runs: how many a second,
#                two cores beside one, memory; into docs/performance.md. About ten minutes on two cores
#   make soak    ten minutes in real time: nothing lost, no memory grown
#   make lock    renew requirements/*.txt, the locks with hashes, from requirements/*.in
#
# With a sourced ROS installation (it sets ROS_DISTRO) its rclpy is used; without one ROS comes from the wheels in requirements/ros.txt.

SHELL := /bin/bash
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Of its own for each kind of ROS, so that sourcing another one makes the environment anew.
READY := $(VENV)/.ready-$(or $(ROS_DISTRO),wheels)
# Small matrices only: threads of the linear algebra stand in each other's way, and in that of the tests beside them.
export OPENBLAS_NUM_THREADS := 1
# Demo and tests start hundreds of processes: each would have to compile all sources anew.
unexport PYTHONDONTWRITEBYTECODE
PIP := $(BIN)/python -m pip --disable-pip-version-check
LOCK := uv pip compile --quiet --upgrade --universal --python-version 3.10 --generate-hashes --no-annotate \
        --custom-compile-command "make lock"

ifdef ROS_DISTRO
  VENV_OPTIONS := --system-site-packages
  LOCKS := requirements/python.txt
else
  LOCKS := requirements/python.txt requirements/ros.txt
endif

.PHONY: demo live test test-unit faults bad-samples test-repeat test-floors lint paper evaluation docs site bench soak lock clean

demo: $(READY)
	$(BIN)/python -m backlash_ros.demo

live: $(READY)
	$(BIN)/python -m backlash_ros.dashboard.live

# What is judged in real time, recorded as fast as it can be simulated, or drawn in a browser runs alone, the rest four at
# a time; plain pytest runs all of it, one after the other.
ALONE := test/system/test_contract.py test/nodes/test_measure.py test/nodes/test_page.py test/nodes/test_transport.py
SIDE_BY_SIDE := -n 4 --dist worksteal
test: $(READY)
	$(BIN)/python -m backlash_ros.simulation  # compiles once for all, on all cores
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) $(ALONE:%=--ignore=%)
	$(BIN)/python -m pytest $(ALONE)

# Faults injected into live processes: once for the page, and twenty times, four at once, on a machine that this loads.
FAULTS := test/nodes/test_faults.py test/nodes/test_parameter_storm.py test/nodes/test_recorder.py -k __
faults: $(READY)
	$(BIN)/python -m pytest $(FAULTS) --faults-page docs/faults.md

# What one wrong sample, or ten, do to the load: a grid of values, offline, into docs/faults.md; some minutes.
bad-samples: $(READY)
	$(BIN)/python test/support/bad_samples.py docs/faults.md

test-repeat: $(READY)
	$(BIN)/python test/support/repeat.py --times 20 --at-once 4 -- $(FAULTS)

test-unit: $(READY)
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) backlash_ros test/unit

lint: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/zensical build --strict  # every link of the pages leads somewhere

paper: $(READY)
	$(BIN)/python -m backlash_ros.cli figures --out docs/figures --page docs/paper.md

DRIVES ?= 2000
evaluation: $(READY)
	$(BIN)/backlash evaluate --seed 1 --drives $(DRIVES) --json results/evaluation/evaluation.json --out results/evaluation
	$(BIN)/python test/support/evaluation_page.py results/evaluation

docs: $(READY)
	$(BIN)/python test/support/parameter_table.py
	$(BIN)/python test/support/telemetry_table.py
	$(BIN)/python test/support/dashboard_picture.py

site: $(READY)
	$(BIN)/zensical build --clean --strict

bench: $(READY)
	rm -f results/bench.json
	$(BIN)/python -m backlash_ros.simulation  # compiles first
	$(BIN)/python benchmarks/plant.py
	$(BIN)/python benchmarks/batch.py
	$(BIN)/python benchmarks/tick.py
	$(BIN)/python benchmarks/closed_loop.py
	$(BIN)/python benchmarks/real_time.py axes --seconds 20
	$(BIN)/python benchmarks/real_time.py lockstep --seconds 20
	$(BIN)/python benchmarks/real_time.py identify --seconds 40
	$(BIN)/python benchmarks/real_time.py dashboard --seconds 20
	$(BIN)/python benchmarks/real_time.py step --seconds 10
	$(BIN)/python benchmarks/stopped_listener.py --seconds 20

soak: $(READY)
	$(BIN)/python benchmarks/real_time.py soak

# The pure tests on the oldest supported dependencies, less those of the gates, which have none, and of the architecture,
# which read our sources alone. numba 0.58 has wheels up to Python 3.11.
FLOORS := .venv-floors
NO_FLOOR := test/unit/test_gates.py test/unit/test_architecture.py
test-floors: $(FLOORS)/.ready
	$(FLOORS)/bin/python -m backlash_ros.simulation
	$(FLOORS)/bin/python -m pytest $(SIDE_BY_SIDE) -m "not population" backlash_ros test/unit $(NO_FLOOR:%=--ignore=%)

$(FLOORS)/.ready: requirements/floors.txt
	@echo "== $(FLOORS): Python environment with the oldest supported dependencies"
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info < (3, 12) else "test-floors needs Python 3.10 or 3.11: make test-floors PYTHON=python3.11")'
	rm -rf $(FLOORS)
	$(PYTHON) -m venv $(FLOORS)
	$(FLOORS)/bin/python -m pip --disable-pip-version-check install --quiet --require-hashes -r requirements/floors.txt
	touch $@

$(READY): $(LOCKS)
	@echo "== $(VENV): Python environment from $(LOCKS), once; about a minute"
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV_OPTIONS) $(VENV)
	$(PIP) install --quiet --require-hashes $(LOCKS:%=-r %)
	$(PIP) install --quiet --no-deps --no-build-isolation --editable .
	touch $@

lock:
	$(PYTHON) -m venv .venv-lock
	.venv-lock/bin/python -m pip --disable-pip-version-check install --quiet uv
	.venv-lock/bin/$(LOCK) -o requirements/python.txt requirements/python.in
	.venv-lock/bin/$(LOCK) -c requirements/python.txt -o requirements/ros.txt requirements/ros.in
	.venv-lock/bin/$(LOCK) -o requirements/floors.txt requirements/floors.in

clean:
	rm -rf .venv .venv-floors .venv-lock build install log results
