# Each target builds .venv if it is missing or older than the locks, and changes nothing else outside the project.
#
#   make install only that: .venv with all commands; also what make without a target does
#   make demo    learn the backlash and judge four laws, on real ROS 2 in lockstep, recorded: results in results/demo
#   make live    a simulated drive, its controller and a page for the browser; prints the address
#   make test    all tests but the grids, in about fourteen minutes on two cores
#   make test-grid  the grids: one claim over many drives, seeds, pairs of laws or options; what takes long
#   make faults  injects every fault and writes docs/faults.md; make test-repeat does it twenty times under load
#   make bad-samples  effect of wrong samples on the load, at the end of docs/faults.md
#   make lint    formatting, style, types, and the links of the pages
#   make paper   the paper's figures and docs/paper.md, which judges them
#   make evaluation  2,000 random drives, learned, identified and played, for docs/evaluation.md; DRIVES=200 judges fewer
#   make docs    docs/parameters.md and docs/interface.md's table from the code; the pictures of docs/law.md; the
#                pictures of the dashboard, with Chromium
#   make site    the documentation as a site, in results/site
#   make bench   about ten minutes on two cores, for docs/performance.md: the plant against the same equations in C and
#                against scipy; batches of runs on one core and on two, and their memory; the cost of a tick; references
#                that move again in flight; the offline loop against scipy; six axes in real time; lockstep; an axis that
#                identifies its drive against one at rest; an axis at 1 kHz with and without ten pages of the dashboard;
#                a step of the node against a bare publish; a stopped listener, by shared memory and by UDP
#   make sensitivity  about an hour, for docs/evaluation.md: how much each tuned number of the law of planned moves matters
#   make soak    ten minutes in real time: no sample lost, no growth of memory
#   make lock    renews requirements/*.txt, the locks with hashes, from requirements/*.in
#
# A sourced ROS installation (which sets ROS_DISTRO) provides rclpy; without one, rclpy comes from the wheels in requirements/ros.txt.

SHELL := /bin/bash
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# One for each kind of ROS, so that sourcing another one rebuilds the environment.
READY := $(VENV)/.ready-$(or $(ROS_DISTRO),wheels)
# The matrices are small: more threads of the linear algebra would only hinder each other.
export OPENBLAS_NUM_THREADS := 1
# Demo and tests start hundreds of processes; with it, each would compile all sources anew.
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

.PHONY: install demo live test test-grid test-unit faults bad-samples test-repeat test-floors lint paper evaluation docs site bench sensitivity soak lock clean

install: $(READY)

demo: $(READY)
	$(BIN)/python -m backlash_ros.demo

live: $(READY)
	$(BIN)/python -m backlash_ros.dashboard.live

# Tests that are judged in real time run after the others, on two cores of their own; all others run four at a time, each
# file by one process, which makes once what its tests share. Plain pytest runs all tests, the grids too, one after the
# other.
REAL_TIME := test/system/test_contract.py test/nodes/test_transport.py test/nodes/test_page.py
SIDE_BY_SIDE := -n 4 --dist loadscope
LONG_FIRST := --no-loadscope-reorder
test: $(READY)
	$(BIN)/python -m backlash_ros.simulation  # compiles once for all, on all cores
	$(BIN)/python -m pytest -m "not grid" $(SIDE_BY_SIDE) $(LONG_FIRST) $(REAL_TIME:%=--ignore=%)
	$(BIN)/python -m pytest -m "not grid" -n 2 --dist loadfile $(REAL_TIME)

test-grid: $(READY)
	$(BIN)/python -m backlash_ros.simulation
	$(BIN)/python -m pytest -m grid $(SIDE_BY_SIDE) $(LONG_FIRST) $(REAL_TIME:%=--ignore=%)
	$(BIN)/python -m pytest -m grid -n 2 --dist loadfile $(REAL_TIME)

# Faults injected into live processes: once for the page; and twenty times, four at once, on a machine that this loads.
FAULTS := test/nodes/test_faults.py test/nodes/test_parameter_storm.py test/nodes/test_recorder.py -k __
faults: $(READY)
	$(BIN)/python -m pytest $(FAULTS) --faults-page docs/faults.md

# Effect of one wrong sample, or ten, on the load: a grid of values, offline, into docs/faults.md; takes some minutes.
bad-samples: $(READY)
	$(BIN)/python test/support/bad_samples.py docs/faults.md

test-repeat: $(READY)
	$(BIN)/python test/support/repeat.py --times 20 --at-once 4 -- $(FAULTS)

test-unit: $(READY)
	$(BIN)/python -m pytest -m "not grid" $(SIDE_BY_SIDE) backlash_ros test/unit

lint: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/zensical build --strict  # every link of the pages leads somewhere

paper: $(READY)
	$(BIN)/python -m backlash_ros.cli figures --out docs/figures --page docs/paper.md

DRIVES ?= 2000
EVALUATION := --population full --model identified --laws two_region planned
evaluation: $(READY)
	$(BIN)/backlash evaluate --seed 961029 --drives $(DRIVES) $(EVALUATION) --json results/evaluation/evaluation.json --out results/evaluation
	$(BIN)/python test/support/evaluation_page.py results/evaluation

docs: $(READY)
	$(BIN)/python test/support/parameter_table.py
	$(BIN)/python test/support/telemetry_table.py
	$(BIN)/backlash figures planned --out docs/images
	$(BIN)/python test/support/dashboard_picture.py

site: $(READY)
	$(BIN)/zensical build --clean --strict

bench: $(READY)
	rm -f results/bench.json
	$(BIN)/python -m backlash_ros.simulation  # compiles first
	$(BIN)/python benchmarks/plant.py
	$(BIN)/python benchmarks/batch.py
	$(BIN)/python benchmarks/tick.py
	$(BIN)/python benchmarks/moved_in_flight.py --drives 200
	$(BIN)/python benchmarks/closed_loop.py
	$(BIN)/python benchmarks/real_time.py axes --seconds 20
	$(BIN)/python benchmarks/real_time.py lockstep --seconds 20
	$(BIN)/python benchmarks/real_time.py identify --seconds 40
	$(BIN)/python benchmarks/real_time.py dashboard --seconds 20
	$(BIN)/python benchmarks/real_time.py step --seconds 10
	$(BIN)/python benchmarks/stopped_listener.py --seconds 20

sensitivity: $(READY)
	$(BIN)/python benchmarks/sensitivity.py --drives 10

soak: $(READY)
	$(BIN)/python benchmarks/real_time.py soak

# The pure tests on the oldest supported dependencies, each with its first parameters, without those of the gates, which
# depend on nothing, and of the architecture, which only read our sources. numba 0.58 has wheels up to Python 3.11.
FLOORS := .venv-floors
NO_FLOOR := test/unit/test_gates.py test/unit/test_architecture.py
test-floors: $(FLOORS)/.ready
	$(FLOORS)/bin/python -m backlash_ros.simulation
	$(FLOORS)/bin/python -m pytest $(SIDE_BY_SIDE) --first-parameters -m "not population and not grid" backlash_ros test/unit $(NO_FLOOR:%=--ignore=%)

$(FLOORS)/.ready: requirements/floors.txt
	@echo "== $(FLOORS): Python environment with the oldest supported dependencies"
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info < (3, 12) else "test-floors needs Python 3.10 or 3.11: make test-floors PYTHON=python3.11")'
	rm -rf $(FLOORS)
	$(PYTHON) -m venv $(FLOORS)
	$(FLOORS)/bin/python -m pip --disable-pip-version-check install --quiet --no-deps --require-hashes -r requirements/floors.txt
	touch $@

# A lock names every package: without --no-deps, the pip of Python 3.11 takes for `coverage[toml]` a newer coverage than
# the lock's, and refuses it as not locked (pip's issue 12345).
$(READY): $(LOCKS)
	@echo "== $(VENV): Python environment from $(LOCKS), once; about a minute"
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV_OPTIONS) $(VENV)
	$(PIP) install --quiet --no-deps --require-hashes $(LOCKS:%=-r %)
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
