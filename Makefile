# `make demo`: the live node on a rendered bag (`make demo DEMO=--own`: with its own detector too). `make test`: all checks. Both set up what they need in $(VENV).
PYTHON ?= python3
VERSIONS ?= today
VENV ?= .venv
BIN := $(VENV)/bin
# Where rclpy is installed already (a robot with its ROS sourced), that one is used, and its NumPy and OpenCV.
ROS := $(shell $(PYTHON) -c "import rclpy" 2>/dev/null && echo installed)
ifeq ($(ROS),installed)
  VENV_OPTIONS := --system-site-packages
  REQUIREMENTS := -r config/requirements-tools.txt rosbags
else
  REQUIREMENTS := -r config/requirements-ros.txt -r config/requirements-$(VERSIONS).txt
endif
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_DOMAIN_ID ?= 77

.PHONY: demo test tests figures lint setup clean

demo: setup
	$(BIN)/python -m elevator_rectify demo --domain $(ROS_DOMAIN_ID) $(DEMO)

test: lint $(VENV)/ready-interfaces
	rm -f .cache/coverage.*
	$(BIN)/python -m coverage run -m pytest -q --all --durations=8 $(PYTEST)
	$(BIN)/python -m coverage combine -q && $(BIN)/python -m coverage report

# The same without coverage, which takes a sixth of their time.
tests: lint $(VENV)/ready-interfaces
	$(BIN)/python -m pytest -q --all --durations=8 $(PYTEST)

# A fixed set of benchmarks beside the committed figures; fails where a rate fell by more than its sampling error.
figures: setup
	$(BIN)/python -m elevator_rectify benchmark --fixed --data ../shared/data --json .cache/figures.json --compare docs/figures.json

lint: setup
	$(BIN)/ruff check . && $(BIN)/mypy

setup: $(VENV)/ready-$(VERSIONS)

$(VENV)/ready-$(VERSIONS): $(wildcard config/requirements-*.txt)
	@echo "setting up $(VENV) (about a minute, once) ..."
	$(PYTHON) -m venv $(VENV_OPTIONS) $(VENV)
	$(BIN)/pip install --disable-pip-version-check --progress-bar on $(REQUIREMENTS)
	touch $@

# Stand-ins for message packages that are not on PyPI; where ROS is installed, its own are used.
$(VENV)/ready-interfaces: $(VENV)/ready-$(VERSIONS) $(wildcard test/interfaces/*/msg/*.msg test/interfaces/build.py elevator_rectify_interfaces/*/*.action)
ifneq ($(ROS),installed)
	$(BIN)/pip install --disable-pip-version-check --progress-bar on -r config/requirements-interfaces.txt
	$(BIN)/python test/interfaces/build.py
endif
	touch $@

clean:
	rm -rf $(VENV) .cache build install log out
