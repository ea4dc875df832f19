# facelab: `make lab` opens the lab, `make test` proves it. Both set up everything they need.

# The first Python of version 3.11 or newer; name another with `make PYTHON=...`.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin

# Real data: a folder that may hold ICT-FaceKit/ and captures/. What is not there is downloaded
# by `make data` (with checksums); without it the lab runs on synthetic faces, and says so.
DATA ?= ../shared
ifneq ($(wildcard $(DATA)/ICT-FaceKit/FaceXModel),)
export FACELAB_ICT ?= $(abspath $(DATA)/ICT-FaceKit)
endif
ifneq ($(wildcard $(DATA)/captures/*.csv),)
export FACELAB_CAPTURES ?= $(abspath $(DATA)/captures)
endif
ifneq ($(wildcard $(DATA)/captures/animface/*.ma),)
export FACELAB_ANIMFACE ?= $(abspath $(DATA)/captures/animface)
endif
NOTEBOOKS := $(wildcard notebooks/*.ipynb)

.PHONY: help lab app env data test lint unit test-notebooks browser test-browser notebooks results \
	bench lock clean

help:
	@echo "make lab        set up all, open the lab in JupyterLab"
	@echo "make app        only the posing lab, as a page of its own"
	@echo "make test       set up all, run every test: unit, notebooks, the lab in a real browser"
	@echo "make env        only the environment, in .venv"
	@echo "make data       only the data (real faces are downloaded once, synthetic ones made)"
	@echo "make notebooks  run every notebook in place and store its outputs"
	@echo "make results    every error of the generalisation experiments, as CSV in results/"
	@echo "make bench      run the benchmarks"
	@echo "make lock       resolve requirements.lock and environment.yml anew from pyproject.toml"
	@echo "make clean      remove .venv and what the tests left"

env: .venv/ready

.venv/ready: pyproject.toml requirements.lock jupyterlab_overrides.json
	@test -n "$(PYTHON)" || { echo "facelab needs Python 3.11 or newer: none found on the PATH. \
Install one, or name it: make PYTHON=/path/to/python3.11 env"; exit 1; }
	@$(PYTHON) -m venv --clear .venv || { echo "$(PYTHON) cannot make a virtual environment: \
install its venv module (Debian, Ubuntu: apt-get install python3-venv)."; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@mkdir -p .venv/etc/jupyter/labconfig
	@cp jupyterlab_overrides.json .venv/etc/jupyter/labconfig/default_setting_overrides.json
	@touch $@

data: env
	$(BIN)/python -m facelab.data

lab: env data
	$(BIN)/jupyter lab --config=jupyter_server_config.py notebooks/01_capture.ipynb

app: env data
	$(BIN)/jupyter server --config=jupyter_server_config.py --ServerApp.root_dir=app \
		--ServerApp.jpserver_extensions="{'voila.server_extension': True}" \
		--ServerApp.default_url=/voila/render/posing.ipynb

test: lint unit test-notebooks test-browser
	@echo "facelab: every test passed"

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

unit: env
	$(BIN)/python -m pytest tests --ignore tests/browser

test-notebooks: env data
	$(BIN)/python -m pytest --nbval-lax -p no:cacheprovider --nbval-cell-timeout=600 $(NOTEBOOKS)

browser: env
	$(BIN)/python tests/browser/get_browser.py

test-browser: env data browser
	$(BIN)/python -m pytest tests/browser

notebooks: env data
	$(BIN)/jupyter nbconvert --to notebook --execute --inplace \
		--ExecutePreprocessor.store_widget_state=False \
		--ExecutePreprocessor.record_timing=False $(NOTEBOOKS)

results: env data
	$(BIN)/python -m facelab.studies.generalisation --out results

bench: env data browser
	$(BIN)/python tests/benchmarks/run.py

lock: env
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --extra test \
		--no-header --no-emit-index-url --no-annotate pyproject.toml -o requirements.lock
	$(BIN)/python tests/environment.py

clean:
	rm -rf .venv .pytest_cache *.egg-info
