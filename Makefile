# `make demo` flies a pursuit, `make test` checks everything. Both set themselves up:
# Python 3.11 or newer with pip and venv is all that is needed.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEPS := pyproject.toml constraints.txt

.DELETE_ON_ERROR:
.PHONY: help demo ros sitl test check lint types tests golden docs format coverage clean

help: ## List what can be made
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

$(VENV)/core.stamp: $(DEPS)
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed: make PYTHON=python3.11 …" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/dev.stamp: $(VENV)/core.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt --no-deps \
		vot-toolkit MAVProxy pyserial
	@touch $@

demo: $(VENV)/core.stamp ## Fly a pursuit in the simulator and write a report
	$(BIN)/follower demo

sitl: $(VENV)/core.stamp ## Fly every scenario on the programs in ARDUCOPTER_SITL and PX4_SITL
	@if [ -z "$$ARDUCOPTER_SITL" ] && [ -z "$$PX4_SITL" ]; then \
		echo "make sitl: set ARDUCOPTER_SITL (ArduPilot's build/sitl/bin/arducopter), PX4_SITL (PX4's build/px4_sitl_default) or both"; \
	else \
		[ -n "$$ARDUCOPTER_SITL" ] || echo "make sitl: without ArduCopter, because ARDUCOPTER_SITL is not set"; \
		[ -n "$$PX4_SITL" ] || echo "make sitl: without PX4, because PX4_SITL is not set"; \
		$(BIN)/follower sitl all --link both --no-video; flown=$$?; \
		$(BIN)/python benchmarks/sitl_exercises.py && exit $$flown; \
	fi

test: lint types tests ## Lint, types and all tests

check: lint types $(VENV)/dev.stamp ## Lint, types and the quick tests
	$(BIN)/pytest $(SPREAD) -m "not slow"

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo

types: $(VENV)/dev.stamp
	$(BIN)/mypy

# Three processes also on two cores: many tests wait for programs of their own. A file is one
# process's (stories in the cockpit go on from test to test), long ones under follower/ come first.
SPREAD := --numprocesses 3 --dist loadfile --no-loadscope-reorder

tests: $(VENV)/dev.stamp
	$(BIN)/pytest $(SPREAD)

$(VENV)/ros.stamp: $(VENV)/core.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[ros]' \
		catkin_pkg colcon-ros hypothesis pytest pytest-timeout
	@touch $@

# ROS's wheels start every Python of their environment anew, so they get one of their own.
ros: ## Run the tests between processes of ROS 2, in an environment of their own
	$(MAKE) VENV=.venv-ros .venv-ros/ros.stamp
	.venv-ros/bin/pytest tests/follower/apps/ros

coverage: $(VENV)/dev.stamp ## Tests with a coverage report
	$(BIN)/pytest $(SPREAD) --cov --cov-report=term-missing

golden: $(VENV)/core.stamp ## Fly the golden flights anew and show what has changed
	$(BIN)/python tests/golden/renew.py

$(VENV)/docs.stamp: $(VENV)/core.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

docs: $(VENV)/docs.stamp ## Build the documentation into site/, which works offline
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

format: $(VENV)/dev.stamp ## Format the sources
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## Remove the virtual environment and all caches
	rm -rf $(VENV) .venv-ros build dist site .coverage .mypy_cache .pytest_cache .ruff_cache .hypothesis
