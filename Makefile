# Every target sets up what it needs. PYTHON chooses the interpreter that makes .venv; by default the first that fits.
FITS := import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c '$(FITS)' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
TORCH ?= 2.13.0
STORE := sqlite:///outputs/mlflow.db
STUDY ?= outputs/smoke/study.journal

# uv installs: the one on the PATH, else one that pip puts into .venv. It reads none of pip's settings, so that what they
# say of where packages are is passed on, as is that the newest version of all these places counts.
UV_ON_PATH := $(shell uv --version >/dev/null 2>&1 && echo uv)
UV := $(or $(UV_ON_PATH),$(BIN)/uv)
pip_setting = $(or $(PIP_$(1)),$(shell $(BIN)/pip config get global.$(2) 2>/dev/null))
PLACES = $(patsubst %,--default-index='%',$(call pip_setting,INDEX_URL,index-url)) \
	$(patsubst %,--index='%',$(call pip_setting,EXTRA_INDEX_URL,extra-index-url)) \
	$(patsubst %,--find-links='%',$(call pip_setting,FIND_LINKS,find-links)) \
	$(if $(filter 1 true yes on,$(call pip_setting,NO_INDEX,no-index)),--no-index) --index-strategy=unsafe-best-match
# Where Python may not write bytecode, each process would compile torch and all else anew: what runs and reports import
# is compiled once. All that is installed would take three times as long.
IMPORTED = parking_exp.training.train_run, parking_exp.tracking.store, parking_exp.reports.run, parking_exp.tuning.study, \
	mlflow.store.tracking.sqlalchemy_store, mlflow.store.artifact.local_artifact_repo, matplotlib.backends.backend_agg, highway_env
COMPILE = $(if $(PYTHONDONTWRITEBYTECODE),env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -c 'import $(IMPORTED)')
INSTALL = $(UV) pip install --python $(BIN)/python --constraint constraints.txt --build-constraint constraints.txt $(PLACES)

.DEFAULT_GOAL := help
.PHONY: help setup train test test-slow test-server lint types docs check ui tensorboard dashboard benchmark results-page lock clean

help:  ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):[^#]*## /\1\t/' | expand -t 14

setup: $(VENV)/.installed  ## make .venv and install the package with pinned versions

$(BIN)/pip:
	@$(or $(PYTHON),false) -c '$(FITS)' || { echo "no Python 3.11 to 3.13 found; name one: make PYTHON=/path/to/python" >&2; exit 2; }
	@echo "making $(VENV) with $(PYTHON)"
	@$(PYTHON) -m venv $(VENV)

$(BIN)/uv: | $(BIN)/pip
	@echo "installing uv into $(VENV), which installs the rest"
	@$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt uv

$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/pip $(if $(UV_ON_PATH),,$(UV))
	@echo "installing the pinned packages into $(VENV), once; some 500 MB are downloaded where no cache has them"
	@$(INSTALL) --editable '.[dev]'
	@$(COMPILE)
	@touch $@

$(VENV)/.ui: $(VENV)/.installed
	@echo "installing the full mlflow and Optuna's dashboard, once"
	@$(INSTALL) --editable '.[dev,ui]'
	@touch $@

train: setup  ## train the default recipe (ARGS='key=value ...' to change it)
	$(BIN)/python scripts/train.py $(ARGS)

test: setup  ## the fast test suite, on two cores
	$(BIN)/python -m pytest --numprocesses=2 --dist=worksteal $(ARGS)

test-slow: setup  ## the proofs that take minutes
	$(BIN)/python -m pytest -m slow $(ARGS)

test-server: $(VENV)/.ui  ## the tests that need an MLflow server, which the full mlflow has
	$(BIN)/python -m pytest -m server $(ARGS)

lint: setup  ## style, format, and imports between rooms
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: setup  ## static types
	$(BIN)/mypy

docs: setup  ## the documentation as a site, in site/; a broken link, anchor or reference fails
	$(BIN)/zensical build --clean --strict

check: lint types docs test  ## lint + types + docs + tests, as CI runs them

benchmark: setup  ## speed, as ratios measured side by side
	$(BIN)/python scripts/benchmark.py $(ARGS)

ui: $(VENV)/.ui  ## MLflow's web UI on our store
	@echo "MLflow may open its GenAI view: choose 'Model training' at the top left, once, or open the address"
	@echo "that follows (by default http://127.0.0.1:5000) with /#/experiments/1?workflowType=machine_learning after it"
	MLFLOW_DISABLE_TELEMETRY=true $(BIN)/mlflow ui --backend-store-uri $(STORE) $(ARGS)

dashboard: $(VENV)/.ui  ## Optuna's dashboard on a study (STUDY=outputs/NAME/study.journal)
	$(BIN)/optuna-dashboard $(STUDY) $(ARGS)

tensorboard: setup  ## TensorBoard on all runs
	$(BIN)/tensorboard --logdir outputs $(ARGS)

results-page: setup  ## docs/results.md and README's rates, from the exports in docs/results
	$(BIN)/python scripts/results_page.py $(ARGS)

lock: | $(BIN)/pip $(if $(UV_ON_PATH),,$(UV))  ## write constraints.txt anew: the newest versions that fit (TORCH=VERSION chooses torch)
	@rm -f $(VENV)/resolved.txt
	printf 'torch==$(TORCH)\nuv\n' | $(UV) pip compile --quiet --python $(BIN)/python --extra dev --extra ui --no-header \
		--no-annotate $(PLACES) --output-file $(VENV)/resolved.txt pyproject.toml - >/dev/null
	@echo '# Versions that were resolved and tested together (make lock writes this file).' > constraints.txt
	sed -E 's/\+cpu$$//; /^(-|--)/d' $(VENV)/resolved.txt >> constraints.txt

clean:  ## delete .venv and caches; outputs/ stays
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .cache site dist build *.egg-info
