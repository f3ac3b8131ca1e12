# Targets that need the set-up make it first. PYTHON is the interpreter of .venv; default: the first one found in 3.11 to 3.13.
FITS := import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c '$(FITS)' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
TORCH ?= 2.13.0
STORE := sqlite:///outputs/mlflow.db
STUDY ?= outputs/smoke/study.journal
UI_PORT = $(or $(shell echo '$(ARGS)' | sed -nE 's/.*(--port|-p)[ =]*([0-9]+).*/\2/p'),5000)

# Packages are installed by uv: the one on the PATH, or one that pip installs into .venv. uv does not read pip's settings,
# so the package indexes are passed on; as with pip, the newest version of all indexes wins.
UV_ON_PATH := $(shell uv --version >/dev/null 2>&1 && echo uv)
UV := $(or $(UV_ON_PATH),$(BIN)/uv)
pip_setting = $(or $(PIP_$(1)),$(shell $(BIN)/pip config get global.$(2) 2>/dev/null))
PLACES = $(patsubst %,--default-index='%',$(call pip_setting,INDEX_URL,index-url)) \
	$(patsubst %,--index='%',$(call pip_setting,EXTRA_INDEX_URL,extra-index-url)) \
	$(patsubst %,--find-links='%',$(call pip_setting,FIND_LINKS,find-links)) \
	$(if $(filter 1 true yes on,$(call pip_setting,NO_INDEX,no-index)),--no-index) --index-strategy=unsafe-best-match
# With PYTHONDONTWRITEBYTECODE, every process would compile torch again: compile once what runs and reports import.
IMPORTED = from parking_exp import load, load_model, train; import highway_env, matplotlib.backends.backend_agg, optuna, torch._dynamo; \
	import mlflow.store.artifact.local_artifact_repo, mlflow.store.tracking.sqlalchemy_store; \
	import compileall, mlflow.store.db_migrations as m; compileall.compile_dir(m.__path__[0], quiet=1)
COMPILE = $(if $(PYTHONDONTWRITEBYTECODE),env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -c '$(IMPORTED)')
INSTALL = $(UV) pip install --python $(BIN)/python --constraint constraints.txt --build-constraint constraints.txt $(PLACES)

.DEFAULT_GOAL := help
.PHONY: help setup train test test-slow test-server lint types docs check ui tensorboard dashboard benchmark results-page lock clean

help:  ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):[^#]*## /\1\t/' | expand -t 14

setup: $(VENV)/.installed  ## create .venv and install pinned versions

$(BIN)/pip:
	@$(or $(PYTHON),false) -c '$(FITS)' || { echo "no Python 3.11 to 3.13 found; name one: make PYTHON=/path/to/python" >&2; exit 2; }
	@echo "making $(VENV) with $(PYTHON)"
	@$(PYTHON) -m venv $(VENV)

$(BIN)/uv: | $(BIN)/pip
	@echo "installing uv into $(VENV), which installs the rest"
	@$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt uv

$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/pip $(if $(UV_ON_PATH),,$(UV))
	@echo "installing the pinned packages into $(VENV), once; about 500 MB are downloaded without a cache"
	@$(INSTALL) --editable '.[dev]'
	@$(COMPILE)
	@touch $@
	@echo "installed; make train trains the default recipe"

$(VENV)/.ui: $(VENV)/.installed
	@echo "installing the full mlflow and Optuna's dashboard, once"
	@$(INSTALL) --editable '.[dev,ui]'
	@touch $@

train: setup  ## train the default recipe (ARGS='key=value ...' to change it)
	$(BIN)/python scripts/train.py $(ARGS)

test: setup  ## run the fast tests on two cores
	$(BIN)/python -m pytest --numprocesses=2 --dist=worksteal $(ARGS)

test-slow: setup  ## run the tests that take minutes
	$(BIN)/python -m pytest -m slow $(ARGS)

test-server: $(VENV)/.ui  ## run the tests that need an MLflow server (installs the full mlflow)
	$(BIN)/python -m pytest -m server $(ARGS)

lint: setup  ## check style, format and imports between packages
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: setup  ## check types
	$(BIN)/mypy

docs: setup  ## build the documentation into site/; broken links fail
	$(BIN)/zensical build --clean --strict

check: lint types docs test  ## lint, types, docs and tests, as in CI

benchmark: setup  ## measure speed relative to named peers
	$(BIN)/python scripts/benchmark.py $(ARGS)

ui: $(VENV)/.ui  ## MLflow's web UI
	@echo "open an experiment; the names of finished runs begin with their success rates:"
	-@$(BIN)/python -m parking_exp.tracking.ui_addresses $(STORE) $(UI_PORT)
	MLFLOW_DISABLE_TELEMETRY=true $(BIN)/mlflow ui --workers 1 --backend-store-uri $(STORE) $(ARGS)

dashboard: $(VENV)/.ui  ## Optuna's dashboard on a study (STUDY=outputs/NAME/study.journal)
	$(BIN)/optuna-dashboard $(STUDY) $(ARGS)

tensorboard: setup  ## TensorBoard on all runs
	$(BIN)/tensorboard --logdir outputs $(ARGS)

results-page: setup  ## write the result pages, their figures and README's parts from docs/results
	$(BIN)/python scripts/results_page.py $(ARGS)

lock: | $(BIN)/pip $(if $(UV_ON_PATH),,$(UV))  ## update constraints.txt (TORCH=VERSION chooses torch)
	@rm -f $(VENV)/resolved.txt
	printf 'torch==$(TORCH)\nuv\n' | $(UV) pip compile --quiet --python $(BIN)/python --extra dev --extra ui --no-header \
		--no-annotate $(PLACES) --output-file $(VENV)/resolved.txt pyproject.toml - >/dev/null
	@echo '# Versions that were resolved and tested together (make lock writes this file).' > constraints.txt
	sed -E 's/\+cpu$$//; /^(-|--)/d' $(VENV)/resolved.txt >> constraints.txt

clean:  ## delete .venv and caches, not outputs/
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .cache site dist build *.egg-info
