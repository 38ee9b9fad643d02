# Each target does all its own set-up; after the first run nothing needs the network.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
export OPENBLAS_NUM_THREADS ?= 1
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.PHONY: run test test-fast test-slow lint bench lock clean

$(READY): requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $(READY)

run: $(READY)
	$(BIN)/los-testbed run

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint
	$(BIN)/pytest -n 2 -m "not slow and not ros" --doctest-modules --ignore=ros_ws --ignore=examples --ignore=benchmarks
	$(BIN)/pytest -m "ros and not slow" tests

test-slow: $(READY)
	$(BIN)/pytest -m slow tests

lock:
	$(PYTHON) -m venv .venv-lock && .venv-lock/bin/pip install --quiet uv
	echo 'numpy>=2.2,<2.3' > .venv-lock/override.txt
	.venv-lock/bin/uv pip compile --universal --python-version 3.10 --all-extras --no-header --no-annotate \
	    --override .venv-lock/override.txt pyproject.toml -o requirements.lock

clean:
	rm -rf .venv .venv-lock .pytest_cache .mypy_cache .ruff_cache ros_ws/build ros_ws/install ros_ws/log
