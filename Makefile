# Longreach: everything runs from the virtual environment in .venv; `make help` lists the targets.
#
# A fresh machine needs Python 3.11, 3.12 or 3.13 and make. Dependencies are pinned with hashes in requirements.lock
# (what runs) and requirements-dev.lock (that and what tests); pip finds them where it is configured to.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
# Byte code is kept whatever the surroundings say: without it each of our many processes compiles every source anew.
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3.13 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
RUN_STAMP := $(VENV)/.stamp-run
DEV_STAMP := $(VENV)/.stamp-dev
PEERS_STAMP := $(VENV)/.stamp-peers
AUDIT := $(VENV)-audit
ROS := $(VENV)-ros
ROS_INTERFACES := tests/longreach_ros2/interfaces
# pip compiles byte code on one core; this does on all (some packages ship files that no Python reads).
BYTE_CODE = $(BIN)/python -m compileall -q -j 0 $(VENV)/lib > /dev/null || true
PIP_FLAGS := --quiet --no-compile --no-deps --require-hashes
LOCK_FLAGS := --generate-hashes --no-emit-index-url --no-header --python-version 3.11
ARGS ?=
PROCESSES ?= 2
PYTEST := $(BIN)/python -m pytest -n $(PROCESSES) --dist loadfile --no-loadscope-reorder
FOREIGN_TOOLS := mbpoll tshark gcc
BROWSERS := chromium chromium-browser google-chrome

# What `make test` leaves to `make test-all`: campaigns, mutants, and what needs programs of others.
LABORATORY := $(addprefix tests/, \
	bad_input browser controller_st longreach_ros2 packaging tools \
	$(addprefix conformance/test_, c_controller.py mutants.py own_plant.py reference_suite.py runner.py first_hour.py) \
	$(addprefix controller/test_, after_stop.py load_holding.py) \
	dissector/test_tshark.py \
	faults/test_vision.py \
	foundation/test_compiled.py \
	$(addprefix integration/test_, event_logs.py flood.py foreign_peers.py killed_controller.py live.py missing_parts.py \
		prometheus.py stop_behind_flood.py stop_way.py crashes.py compose.py containers.py same_twice.py) \
	longreach/test_documented.py longreach/test_pages_run.py \
	plant_emulator/shell/test_plant_process.py \
	laboratory \
	$(addprefix testbed/, arms camera cli commissioning exports \
		hand_eye test_lockstep_repeats.py lockstep/test_warm_up.py \
		pictures recordings reporting scenarios/test_nobody_knows.py) \
	$(addprefix vision_pc/, $(addprefix hand_eye/test_, conventions.py held_out.py robust.py) \
		$(addprefix odometry/test_, arm_motion.py segments.py varied_sequences.py) \
		$(addprefix perception/test_, chance_markers.py other_prints.py stereo_fit.py) \
		$(addprefix targets/test_, measuring.py surroundings.py) \
		$(addprefix shell/test_, api_schema.py genicam.py strangers.py target_routes.py)))

# A whole machine beside ROS for each file: one at a time, or two cores do not keep up.
BRIDGE_TESTS := tests/longreach_ros2/bridge

.PHONY: help setup setup-dev demo test test-all other-machines pythons coverage foreign-tools peers ros-peers prometheus browser bench bench-before experiments docs lint types imports compose-test sbom audit lock clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "Longreach needs Python 3.11, 3.12 or 3.13: none was found; name one with PYTHON=..." >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; found = ".".join(map(str, sys.version_info[:3])); sys.exit(0 if (3, 11) <= sys.version_info[:2] <= (3, 13) else f"Longreach needs Python 3.11, 3.12 or 3.13, found {found} at {sys.executable}; name another with PYTHON=...")'
	"$(PYTHON)" -m venv $(VENV)

$(RUN_STAMP): requirements.lock pyproject.toml laboratory/pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install $(PIP_FLAGS) -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e . -e ./laboratory
	$(BYTE_CODE)
	@echo "compiling kernels, once: about a minute of two cores; the cache is kept for later environments"
	$(BIN)/python -m testbed.lockstep.warm_up
	@touch $@

$(DEV_STAMP): requirements-dev.lock $(RUN_STAMP)
	$(BIN)/python -m pip install $(PIP_FLAGS) -r requirements-dev.lock
	$(BYTE_CODE)
	@touch $@

$(PEERS_STAMP): requirements-peers.lock $(DEV_STAMP)
	$(BIN)/python -m pip install $(PIP_FLAGS) -r requirements-peers.lock
	@touch $@

setup: $(RUN_STAMP)  ## virtual environment with what runs

setup-dev: $(DEV_STAMP)  ## that and what tests

demo: $(RUN_STAMP)  ## the whole loop, three processes, as fast as they go; verdict against 5 mm (ARGS="--seed 3")
	$(BIN)/longreach demo --pace 0 $(ARGS)

test: $(DEV_STAMP)  ## the product's tests, five to nine minutes of two cores (ARGS="-k kinematics")
	@$(PYTEST) $(LABORATORY:%=--ignore=%) $(ARGS)

# One budget of retries for all runs (tests/support/real_time.py). Of the laboratory's, what is judged by the wall is
# alone on the machine: three services and an attacker have no core to spare for a second worker.
USUAL := not experiment and not bench and not docker
test-all: export LONGREACH_RETRIED := $(or $(LONGREACH_RETRIED),$(shell mktemp))
test-all: test  ## those, then the laboratory's: experiments, mutants, browser, peers, packaging, pages, containers
	@$(PYTEST) $(LABORATORY) --ignore=$(BRIDGE_TESTS) -m "$(USUAL) and not realtime" $(ARGS)
	@$(BIN)/python -m pytest $(LABORATORY) --ignore=$(BRIDGE_TESTS) -m "$(USUAL) and realtime" $(ARGS)
	@$(BIN)/python -m pytest -m docker --timeout 1800 -rs tests/integration/test_containers.py $(ARGS)
	@$(BIN)/python -m pytest $(BRIDGE_TESTS) $(ARGS)

other-machines: $(DEV_STAMP)  ## numerical tests as four other processors compute, and with inputs off by 1e-9 (ARGS="nehalem 3", "--today")
	PROCESSES=$(PROCESSES) $(BIN)/python -m tests.support.other_machines $(ARGS)

coverage: $(DEV_STAMP)  ## which lines all tests run: a table, and coverage/index.html
	$(PYTEST) --cov --cov-report=term:skip-covered --cov-report=html $(ARGS)

foreign-tools:  ## Debian's mbpoll, tshark, C compiler and Aravis (industrial cameras), which some tests use (root or sudo)
	@missing=; for tool in $(FOREIGN_TOOLS); do command -v $$tool > /dev/null || missing="$$missing $$tool"; done; \
	/sbin/ldconfig -p | grep -q libaravis-0.8.so.0 || missing="$$missing libaravis-0.8-0"; \
	if [ -z "$$missing" ]; then echo "foreign tools: all there"; exit 0; fi; \
	if [ "$$(id -u)" = 0 ]; then as_root=; elif command -v sudo > /dev/null; then as_root=sudo; \
	else echo "foreign tools:$$missing absent, and neither root nor sudo to install them; their tests are skipped" >&2; exit 1; fi; \
	$$as_root apt-get update -qq && DEBIAN_FRONTEND=noninteractive $$as_root apt-get install -y -qq --no-install-recommends $${missing/gcc/gcc libc6-dev} > /dev/null \
	|| { echo "foreign tools:$$missing could not be installed; their tests are skipped" >&2; exit 1; }

peers: $(PEERS_STAMP)  ## readers and detectors of others, which some tests and benchmarks ask too (two are GPL: never in a dependency)

# The wheels execute every Python of their environment anew, with a library path: so they have one of their own, which
# finds our packages in the other. A wheel that shares a file with another loses it where pip has written that first.
$(ROS)/.stamp: requirements-ros.lock $(wildcard $(ROS_INTERFACES)/*.sh $(ROS_INTERFACES)/*/* $(ROS_INTERFACES)/*/*/*) | $(RUN_STAMP)
	rm -rf $(ROS)
	$(BIN)/python -m venv $(ROS)
	$(ROS)/bin/python -m pip install $(PIP_FLAGS) -r requirements-ros.lock
	echo "import site; site.addsitedir('$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')')" > "$$($(ROS)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/longreach_beside.pth"
	$(ROS_INTERFACES)/install.sh $(ROS)
	@touch $@

ros-peers: $(ROS)/.stamp  ## ROS 2 in an environment of its own, which tests of the bridge ask (two minutes; needs cmake and a C++ compiler)

prometheus: $(RUN_STAMP)  ## Debian's Prometheus, unpacked and not installed, which the tests let read the figures
	@test -x $(VENV)/prometheus/usr/bin/prometheus || { cd $(VENV) && apt-get download -qq prometheus && dpkg-deb -x prometheus_*.deb prometheus && rm prometheus_*.deb; } \
	|| { echo "prometheus: not fetched; nothing reads the figures" >&2; exit 1; }

browser:  ## Debian's Chromium, in which the tests try the console (root or sudo)
	@for name in $(BROWSERS); do if command -v $$name > /dev/null; then echo "browser: $$name is there"; exit 0; fi; done; \
	if [ "$$(id -u)" = 0 ]; then as_root=; elif command -v sudo > /dev/null; then as_root=sudo; \
	else echo "browser: absent, and neither root nor sudo to install it; the console is NOT tried" >&2; exit 1; fi; \
	$$as_root apt-get update -qq && DEBIAN_FRONTEND=noninteractive $$as_root apt-get install -y -qq --no-install-recommends chromium > /dev/null \
	|| { echo "browser: chromium could not be installed; the console is NOT tried" >&2; exit 1; }

bench: $(PEERS_STAMP)  ## benchmarks, with their limits and their peers, then bench-before
	$(BIN)/python -m pytest -m bench --benchmark-enable -s $(or $(ARGS),tests/benchmarks)
	$(if $(ARGS),,$(MAKE) bench-before)

bench-before: $(DEV_STAMP)  ## how fast lockstep is beside the commit before, twice each in turn (BEFORE=COMMIT: beside that one)
	rm -rf dist/before && git worktree prune && git worktree add --quiet --detach dist/before $(or $(BEFORE),HEAD~1)
	for tree in dist/before . dist/before .; do ( cd $$tree && PYTHONPATH=$$PWD "$(abspath $(BIN))/python" -m pytest -p no:cacheprovider -q -m bench --benchmark-enable -s tests/benchmarks/test_lockstep.py | sed "s|^|$$tree: |" ) || true; done \
	| awk -F': ' '/times real time/ { split($$3, now, " "); named[$$2]; if (now[1] > best[$$1, $$2]) best[$$1, $$2] = now[1] } \
	END { for (what in named) printf "%s: %.1f times real time, before %.1f, ratio %.2f\n", what, best[".", what], best["dist/before", what], best[".", what] / best["dist/before", what] }'
	git worktree remove --force dist/before

experiments: $(DEV_STAMP)  ## long, seeded experiments
	$(BIN)/python -m pytest -m experiment --timeout 0 -s $(ARGS)

docs: $(DEV_STAMP)  ## the pages as a site with references from the code, and what short commands print: dist/site/index.html
	rm -rf dist/site
	$(BIN)/python -m sphinx -W --keep-going -q -j $(PROCESSES) -d dist/site-read -c docs . dist/site
	$(BIN)/python -m tools.printed --check --quick

lint: $(DEV_STAMP)  ## ruff
	$(BIN)/ruff check .

types: $(DEV_STAMP)  ## mypy, strict
	$(BIN)/mypy

imports: $(DEV_STAMP)  ## who may import whom
	$(BIN)/lint-imports

# Each has an environment of its own, .venv-3.12 or .venv-3.13; pyenv keeps what is not on the path.
pythons:  ## a demonstration and `make test` on another Python that is here: 3.12 and 3.13 by turns of the day, or VERSION=3.13
	@version=$(or $(VERSION),3.$$((12 + 10#$$(date +%j) % 2))); \
	for python in $$(command -v python$$version) $$(ls -d $$HOME/.pyenv/versions/$$version.*/bin/python 2> /dev/null); do \
		"$$python" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$$version')" 2> /dev/null || continue; \
		$(MAKE) VENV=.venv-$$version PYTHON=$$python demo ARGS="--lockstep --seed 1"; \
		exec $(MAKE) VENV=.venv-$$version PYTHON=$$python test ARGS=$(ARGS); \
	done; \
	echo "Python $$version is not here: NOT tried with it"

compose-test: $(DEV_STAMP)  ## build the image, bring the tool to the object with compose
	$(BIN)/python -m pytest -m docker --timeout 1800 -s $(ARGS)

$(AUDIT)/.stamp: requirements-audit.lock | $(BIN)/python
	"$(PYTHON)" -m venv $(AUDIT)
	$(AUDIT)/bin/python -m pip install --quiet --no-deps --require-hashes -r requirements-audit.lock
	@touch $@

sbom: $(AUDIT)/.stamp  ## bill of materials of what runs: dist/longreach.cdx.json (CycloneDX)
	@mkdir -p dist
	$(AUDIT)/bin/cyclonedx-py requirements requirements.lock --pyproject pyproject.toml --output-reproducible --validate --of JSON -o dist/longreach.cdx.json

audit: $(AUDIT)/.stamp  ## known vulnerabilities of what runs; status 1: there are some, or no database could be reached
	$(AUDIT)/bin/pip-audit --strict -r requirements.lock --require-hashes --disable-pip --timeout 10

# The locks are made from pyproject.toml by uv, in an environment of its own. `requirements.lock` holds the
# run-time dependencies and the build back end; `requirements-dev.lock` adds the tools of the tests,
# `requirements-peers.lock` what the benchmarks compare with; `requirements-audit.lock` and `requirements-ros.lock`
# are of environments of their own.
lock:  ## resolve pyproject.toml again into both lock files
	"$(PYTHON)" -m venv $(VENV)-lock
	$(VENV)-lock/bin/python -m pip install --quiet uv
	$(VENV)-lock/bin/uv pip compile pyproject.toml --group build --group laboratory $(LOCK_FLAGS) -o requirements.lock
	$(VENV)-lock/bin/uv pip compile pyproject.toml --group build --group laboratory --group dev -c requirements.lock $(LOCK_FLAGS) -o requirements-dev.lock
	$(VENV)-lock/bin/uv pip compile pyproject.toml --group peers -c requirements-dev.lock $(LOCK_FLAGS) -o requirements-peers.lock
	$(VENV)-lock/bin/uv pip compile --group pyproject.toml:ros -c requirements-dev.lock $(LOCK_FLAGS) -o requirements-ros.lock
	$(VENV)-lock/bin/uv pip compile --group pyproject.toml:audit $(LOCK_FLAGS) -o requirements-audit.lock
	rm -rf $(VENV)-lock

clean:  ## remove the virtual environment and every cache
	rm -rf $(VENV) $(AUDIT) $(ROS) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis .benchmarks
	rm -rf "$${NUMBA_CACHE_DIR:-$${XDG_CACHE_HOME:-$$HOME/.cache}/longreach/kernels}"
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
