# make demo     swing up the reference systems from pixels; table and clips
# make test     the tests of every change;  make test-all: the long ones, too, before a release
# make test-fast  those of the inner loop, without whole diagnoses, trainings and frames
# make fuzz     thousands of damaged inputs;  make kills, make interrupts: hundreds of killed and interrupted commands
# make lint     ruff;  make types: pyright;  make layers: import layers;  make docs: strict documentation
# make tutorials  run docs/tutorials/*.ipynb again, and keep what they print and draw
# make weights  collect data and train the shipped weights anew
# make bench    print every measured figure
# make dist     wheel and sdist to upload, checked

PYTHON ?= python3
BIN := .venv/bin
SEED := 0
DATA_SEED := 1
BY_FILE := --dist loadfile --no-loadscope-reorder# examples of a document build on each other; conftest.py has the order
DEBIAN := Debian, Ubuntu: apt-get install python3-venv libegl1 libgl1-mesa-dri

.PHONY: demo test test-all test-fast fuzz kills interrupts lint types layers docs tutorials weights bench dist libraries opengl clean
.NOTPARALLEL:
.DELETE_ON_ERROR:

demo: libraries .venv/.keycld opengl
	$(BIN)/keycld demo

test: libraries .venv/.keycld-dev opengl
	$(BIN)/python -m pytest -n 2 $(BY_FILE) -m 'not long'

test-all: libraries .venv/.keycld-dev opengl
	$(BIN)/python -m pytest -n 2 $(BY_FILE)

test-fast: libraries .venv/.keycld-dev opengl
	$(BIN)/python -m pytest -n 2 $(BY_FILE) -m 'not slow and not long and not render' tests

fuzz: libraries .venv/.keycld-dev
	$(BIN)/python tests/reliability/fuzz.py --inputs 2000 --seed $(SEED)

kills: libraries .venv/.keycld-dev opengl
	$(BIN)/python tests/reliability/kills.py --kills 200 --seed $(SEED)

interrupts: libraries .venv/.keycld-dev opengl
	$(BIN)/python tests/reliability/interrupts.py --interrupts 100 --seed $(SEED)

lint: .venv/.keycld-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/.keycld-dev
	$(BIN)/pyright

layers: .venv/.keycld-dev
	$(BIN)/lint-imports

docs: .venv/.keycld-docs
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

tutorials: libraries .venv/.keycld-dev opengl
	folder=`mktemp -d` && cp docs/tutorials/*.ipynb $$folder && \
	PATH="$(CURDIR)/$(BIN):$$PATH" jupyter execute --inplace $$folder/*.ipynb && \
	cp $$folder/*.ipynb docs/tutorials/ && rm -r $$folder

weights: libraries .venv/.keycld opengl
	for system in `$(BIN)/python -c 'from keycld_envs import REFERENCE_SYSTEMS; print(*REFERENCE_SYSTEMS)'`; do \
	  $(BIN)/keycld collect $$system --out data/$$system --workers 2 --seed $(DATA_SEED) && \
	  $(BIN)/keycld train $$system --data data/$$system --out runs/$$system --seed $(SEED) && \
	  mkdir -p keycld_model/weights/$$system && \
	  cp runs/$$system/checkpoint.json runs/$$system/weights.safetensors keycld_model/weights/$$system/ || exit 1; \
	done

bench: libraries .venv/.keycld opengl
	$(BIN)/keycld bench

dist: .venv/.keycld-dev
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*

# What is missing to render frames, in one sentence: what can be told before packages are downloaded, and the rest.
libraries: .venv/bin/python
	@[ -n "$$MUJOCO_GL$$DISPLAY" ] || [ "$$(uname)" != Linux ] \
	  || $(BIN)/python -c 'import ctypes; ctypes.CDLL("libEGL.so.1")' 2>/dev/null \
	  || $(BIN)/python -c 'import ctypes; ctypes.CDLL("libOSMesa.so.8")' 2>/dev/null \
	  || { echo "There is no OpenGL library to render frames with; install one ($(DEBIAN))"; exit 1; }

opengl: .venv/.keycld
	@$(BIN)/python -c 'import sys; from keycld_control.cli.doctor import examine; sys.exit("\n".join(examine()["advice"]) or None)'

.venv/bin/python:
	@command -v $(PYTHON) >/dev/null || { echo "There is no $(PYTHON); install Python 3.11 or newer ($(DEBIAN)), or name it: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "KeyCLD needs Python 3.11 or newer, but $(PYTHON) is `$(PYTHON) --version`; name a newer one: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "$(PYTHON) cannot make virtual environments; install the package for it ($(DEBIAN))"; exit 1; }
	$(PYTHON) -m venv --clear .venv

.venv/.keycld: pyproject.toml | .venv/bin/python
	@echo "Installing into .venv; once, for a few minutes"
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

.venv/.keycld-dev: pyproject.toml | .venv/bin/python
	@echo "Installing into .venv; once, for a few minutes"
	$(BIN)/python -m pip install --quiet --editable '.[dev,docs]'
	@touch .venv/.keycld .venv/.keycld-docs $@

.venv/.keycld-docs: pyproject.toml | .venv/.keycld
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@

clean:
	rm -rf .venv docs/_build dist build
