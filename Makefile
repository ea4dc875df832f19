# facelab: `make lab` opens the lab, `make test` proves it. Both set up everything they need.
# `make test` is what a user runs: 20 minutes at most on two quiet cores, from nothing.
# `make test-all` is what takes long beside it.

# The first Python of version 3.11 or newer; name another with `make PYTHON=...`.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin

# Real data: a folder that may hold ICT-FaceKit/, captures/ and rigs/aura/. What is not there is downloaded
# by `make data` (with checksums); without it the lab runs on synthetic faces, and says so.
# FACELAB_OFFLINE=1 forbids the download.
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
ifneq ($(wildcard $(DATA)/rigs/aura/*.npz),)
export FACELAB_AURA ?= $(abspath $(DATA)/rigs/aura)
endif
NOTEBOOKS := $(wildcard notebooks/*.ipynb)

.PHONY: help lab app env data test lint unit test-notebooks browser test-browser test-all \
	test-long test-bare test-wire soak notebooks pictures light seconds site results bench mutants \
	lock clean

help:
	@echo "make lab        set up all, open the lab in JupyterLab"
	@echo "make app        only the posing lab, as a page of its own"
	@echo "make test       set up all, run every test: unit, notebooks, the lab in a real browser"
	@echo "make test-all   what takes long beside it: other settings, slow wires, no data or network"
	@echo "make env        only the environment, in .venv"
	@echo "make data       only the data (real faces are downloaded once, synthetic ones made)"
	@echo "make notebooks  run every notebook in place and store its outputs"
	@echo "make pictures   the labs' pictures of README, made anew by mouse in a browser"
	@echo "make light      the page's light beside an offline render (fetches Mitsuba 3): docs/light.png"
	@echo "make seconds    how long every notebook runs, into notebooks/lecturers.md and the first notebook"
	@echo "make mutants    a sample of the mathematics broken on purpose: which tests notice"
	@echo "make site       the course as static pages, in site/"
	@echo "make results    errors of notebook 04, all models, several captures, rig to rig: tables in results/"
	@echo "make bench      run the benchmarks"
	@echo "make lock       resolve requirements.lock and environment.yml anew from pyproject.toml"
	@echo "make soak       random walks, killed and starved writers, 2,000 mutants of each file (minutes)"
	@echo "make clean      remove .venv and what the tests left"

env: .venv/ready

.venv/ready: pyproject.toml requirements.lock app/jupyterlab_overrides.json
	@test -n "$(PYTHON)" || { echo "facelab needs Python 3.11 or newer: none found on the PATH. \
Install one, or name it: make PYTHON=/path/to/python3.11 env"; exit 1; }
	@$(PYTHON) -m venv --clear .venv || { echo "$(PYTHON) cannot make a virtual environment: \
install its venv module (Debian, Ubuntu: apt-get install python3-venv)."; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes \
		-r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps \
		--no-build-isolation --editable .
	@mkdir -p .venv/etc/jupyter/labconfig
	@cp app/jupyterlab_overrides.json .venv/etc/jupyter/labconfig/default_setting_overrides.json
	@touch $@

data: env
	$(BIN)/python -m facelab.data

lab: env data
	$(BIN)/jupyter lab --config=app/jupyter_server_config.py notebooks/00_start.ipynb

app: env data
	$(BIN)/jupyter server --config=app/jupyter_server_config.py --ServerApp.root_dir=app \
		--ServerApp.jpserver_extensions="{'voila.server_extension': True}" \
		--ServerApp.default_url=/voila/render/posing.ipynb

test: lint unit test-notebooks test-browser
	@echo "facelab: make test passed"

# What runs two at a time has one core each: more threads would wait for each other.
unit test-notebooks test-browser test-long test-bare: export OMP_NUM_THREADS = 1
unit test-notebooks test-browser test-long test-bare: export OPENBLAS_NUM_THREADS = 1

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# Two halves of about the same length, beside each other; a new room falls into the second.
UNIT := $(BIN)/python -m pytest -m "not long"
FIRST_HALF := $(wildcard tests/test_*.py) $(addprefix tests/,cli data expression models registration studies)
SECOND_HALF := $(filter-out $(FIRST_HALF) $(addprefix tests/,benchmarks browser fixtures \
	notebooks __pycache__),$(patsubst %/,%,$(wildcard tests/*/)))

unit: env
	@$(UNIT) $(FIRST_HALF) & first=$$!; $(UNIT) $(SECOND_HALF); second=$$?; \
	wait $$first && exit $$second

# Each notebook from top to bottom; `make test-all` also answers its exercises and changes its settings.
NBVAL := $(BIN)/python -m pytest --nbval-lax -p no:cacheprovider --nbval-cell-timeout=600
TWO_AT_A_TIME := xargs -P 2 -n 1

test-notebooks: env data  # the longest first
	@ls -S $(NOTEBOOKS) | $(TWO_AT_A_TIME) $(NBVAL)

browser: env
	$(BIN)/python tests/browser/get_browser.py

# Two halves of about the same length, beside each other: the posing lab's own tests are in the first.
BROWSER := $(BIN)/python -m pytest -m "not long" tests/browser
FIRST_PAGES := hand_math or hostile or landmark_picker or (posing_lab and not far_from and not of_its_own)

test-browser: env data browser
	@$(BROWSER) -k "$(FIRST_PAGES)" & first=$$!; $(BROWSER) -k "not ($(FIRST_PAGES))"; second=$$?; \
	wait $$first && exit $$second

# What takes long, part by part.
test-all: test-long test-wire test-bare
	@echo "facelab: make test-all passed"

test-long: env data browser
	$(BIN)/python -m pytest tests -m long --ignore=tests/notebooks --ignore=tests/browser
	FACELAB_MUTANTS=300 $(BIN)/python -m pytest tests -k "mutant or broken" -m "not long" \
		--ignore=tests/browser
	@basename -s .ipynb $(NOTEBOOKS) | $(TWO_AT_A_TIME) $(BIN)/python -m pytest tests/notebooks -k

# As on a machine without data and network, with nothing made before.
# What such a machine has of its own is another face: these open one in each lab and page.
BARE_LABS ?= far_from or of_its_own or alpha_and_locks or molds_the_region or rig_is_opened or two_views
NO_DATA := FACELAB_ICT FACELAB_CAPTURES FACELAB_ANIMFACE FACELAB_AURA
BARE := env $(addprefix -u ,$(NO_DATA)) FACELAB_OFFLINE=1
BARE_NOTEBOOKS := $(addprefix notebooks/,05_posing.ipynb 07_sketch_to_action_units.ipynb \
	08_your_own_face.ipynb)

test-bare: env browser
	@FACELAB_CACHE=$$(mktemp -d) && export FACELAB_CACHE && \
	trap 'rm -rf "$$FACELAB_CACHE"' EXIT && trap 'exit 1' INT TERM && set -x && \
	$(BARE) $(BIN)/python -m facelab.data && \
	$(BARE) $(NBVAL) $(BARE_NOTEBOOKS) && \
	$(BARE) $(BROWSER) -k "$(BARE_LABS)"

# Pulls of four lengths over three wires, in every way of posing; BLAS on as many threads as users have.
test-wire: env data browser
	$(BIN)/python -m pytest tests/browser -m long

soak: env
	cd tests && ../$(BIN)/python soak.py
	FACELAB_MUTANTS=2000 $(BIN)/python -m pytest tests -k "mutant or broken" -s -q

notebooks: env data
	$(BIN)/jupyter nbconvert --to notebook --execute --inplace \
		--ExecutePreprocessor.store_widget_state=False \
		--ExecutePreprocessor.record_timing=False $(NOTEBOOKS)
	$(BIN)/python -m facelab.course $(NOTEBOOKS)

pictures: env data browser  # those of README: five poses made by mouse, and both labs
	$(BIN)/python tests/browser/pictures.py

light: env data browser  # nothing else needs Mitsuba, so no environment has it by itself
	$(BIN)/python -m pip install --quiet --disable-pip-version-check mitsuba
	$(BIN)/python tests/browser/offline.py

seconds: env data  # how long notebooks run, into the page for lecturers and the first notebook
	$(BIN)/python tests/notebooks/seconds.py

site: env  # the course as static pages, as its notebooks are stored
	$(BIN)/python -m facelab.course.site site

results: env data
	$(BIN)/python -m facelab.studies.generalisation --out results
	$(BIN)/python -m facelab.studies.benchmark_table --out results
	$(BIN)/python -m facelab.studies.figure5_captures --out results
	$(BIN)/python -m facelab.studies.translation_table --out results
	$(BIN)/python -m facelab.studies.contact_table --out results
	cp results/benchmark.md results/figure5.md results/translation.md results/contact.md docs/

bench: env data browser
	$(BIN)/python tests/benchmarks/run.py

mutants: env
	$(BIN)/python tests/mutate.py --sample 20

lock: env
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 \
		--extra test --extra glb --extra scale --generate-hashes --no-header --no-annotate \
		--no-emit-index-url --no-emit-find-links pyproject.toml -o requirements.lock
	$(BIN)/python tests/environment.py

clean:
	rm -rf .venv .pytest_cache *.egg-info
