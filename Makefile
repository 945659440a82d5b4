# The two commands that matter: `make previs` and `make test`. Both make a virtual environment first.
# A bpy wheel fits one Python: 4.5 LTS needs 3.11, 5.2 LTS needs 3.13. Choose with `make PYTHON=python3.13 ...`.

PYTHON ?= python3.11
VENV ?= .venv
# `EXTRAS=test,train` brings torch, and with it the tests of addon_tests/torch.
EXTRAS ?= test
BIN = $(VENV)/bin
OUT ?= out
# How long `make fuzz` searches.
MINUTES ?= 60

.PHONY: previs test test-fast hard-cases fuzz check format bench scenes clean

previs: $(VENV)/installed
	$(BIN)/xihe previs blend_scenes/living_room.blend --out $(OUT) --preset draft

test: $(VENV)/installed
	$(BIN)/python -m pytest

test-fast: $(VENV)/installed
	$(BIN)/python -m pytest -m "not slow"

hard-cases: $(VENV)/installed
	$(BIN)/python -m addon_tests.pure.hard_cases

fuzz: $(VENV)/installed
	$(BIN)/python addon_tests/fuzz.py --minutes $(MINUTES)

check: $(VENV)/installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(VENV)/installed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(VENV)/installed
	$(BIN)/python addon_tests/bench/nearest.py
	$(BIN)/python addon_tests/bench/steps.py
	$(BIN)/python addon_tests/bench/estimate.py
	$(BIN)/python addon_tests/bench/phone.py
	$(BIN)/python addon_tests/bench/rendering.py
	$(BIN)/python addon_tests/bench/effort.py
	$(BIN)/python addon_tests/bench/effects.py

scenes: $(VENV)/installed
	$(BIN)/xihe scenes build

clean:
	rm -rf $(VENV) build dist *.egg-info

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[$(EXTRAS)]"
	@$(BIN)/python -c "import bpy" || { echo "Blender's libraries are missing: run '.ci/system_packages' as root (Debian, Ubuntu)"; exit 1; }
	@touch $@
