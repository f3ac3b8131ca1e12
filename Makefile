# Every target sets up what it needs. PYTHON chooses the interpreter that makes .venv; by default the first that fits.
FITS := import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c '$(FITS)' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
TORCH ?= 2.13.0
STORE := sqlite:///outputs/mlflow.db

.DEFAULT_GOAL := help
.PHONY: help setup train test test-slow lint types check ui tensorboard benchmark lock clean

help:  ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):[^#]*## /\1\t/' | expand -t 14

setup: $(VENV)/.installed  ## make .venv and install the package with pinned versions

$(VENV)/.installed: pyproject.toml constraints.txt
	@echo "setting up $(VENV), once; this takes a few minutes"
	@$(or $(PYTHON),false) -c '$(FITS)' || { echo "no Python 3.11 to 3.13 found; name one: make PYTHON=/path/to/python" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

$(VENV)/.ui: $(VENV)/.installed
	@echo "installing the full mlflow, once"
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,ui]'
	@touch $@

train: setup  ## train the default recipe (ARGS='key=value ...' to change it)
	$(BIN)/python scripts/train.py $(ARGS)

test: setup  ## the fast test suite, on two cores
	$(BIN)/python -m pytest --numprocesses=2 --dist=worksteal $(ARGS)

test-slow: setup  ## the proofs that take minutes
	$(BIN)/python -m pytest -m slow $(ARGS)

lint: setup  ## style, format, and imports between rooms
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: setup  ## static types
	$(BIN)/mypy

check: lint types test  ## lint + types + tests, as CI runs them

benchmark: setup  ## speed, as ratios measured side by side
	$(BIN)/python scripts/benchmark.py $(ARGS)

ui: $(VENV)/.ui  ## MLflow's web UI on our store
	@echo "MLflow may open its GenAI view: choose 'Model training' at the top left, once, or open"
	@echo "http://127.0.0.1:5000/#/experiments/1?workflowType=machine_learning"
	MLFLOW_DISABLE_TELEMETRY=true $(BIN)/mlflow ui --backend-store-uri $(STORE) $(ARGS)

tensorboard: setup  ## TensorBoard on all runs
	$(BIN)/tensorboard --logdir outputs $(ARGS)

lock:  ## write constraints.txt anew: the newest versions that fit (TORCH=VERSION chooses torch)
	$(PYTHON) -m venv .venv-lock
	.venv-lock/bin/pip install --quiet torch==$(TORCH) '.[dev,ui]'
	echo '# Versions that were resolved and tested together (make lock writes this file).' > constraints.txt
	.venv-lock/bin/pip freeze --exclude parking-exp | sed 's/+cpu$$//' >> constraints.txt
	rm -rf .venv-lock

clean:  ## delete .venv and caches; outputs/ stays
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache dist build *.egg-info
