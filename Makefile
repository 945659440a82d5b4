# The two commands that matter: `make previs` and `make test`. Both make a virtual environment first.
# A bpy wheel fits one Python: 4.5 LTS needs 3.11, 5.2 LTS needs 3.13. Choose with `make PYTHON=python3.13 ...`.

PYTHON ?= python3.11
VENV ?= .venv
# `EXTRAS=test,train` brings torch, and with it the tests of addon_tests/torch.
EXTRAS ?= test
BIN = $(VENV)/bin
OUT ?= out
# Of the path, for `make previs`: as `xihe previs --frames` takes them, 1:24:4 for every fourth. All, if left empty.
FRAMES ?=
# How long `make fuzz` searches.
MINUTES ?= 60

# Dozens of processes import the same modules in the tests: they are compiled once.
unexport PYTHONDONTWRITEBYTECODE

# Of `make weights`: how many rooms are numbered, of which four in five are for training, and among how many the rooms to choose
# the epoch and to test are. Sampled clouds of rooms of another kind set the expected error: ELSEWHERE="FOLDER FOLDER".
WEIGHTS ?= out/weights
ROOMS ?= 3455
ROOMS_BY_DAY ?= 857
VARIED_ROOMS ?= 1605
OTHER_ROOMS ?= 1400
ELSEWHERE ?=

# A whole Blender, its Python, and what the tests need that Blender has not; see addon_tests/run_in_blender.py.
BLENDER ?= blender
BLENDER_PYTHON ?= 3.11
TEST_PACKAGES ?= build/test_packages/$(BLENDER_PYTHON)

.PHONY: previs test test-fast test-packages test-blender test-extension package hard-cases prove-exports fuzz check format bench \
	scenes weights clean

previs: $(VENV)/installed
	$(BIN)/xihe previs blend_scenes/living_room.blend --out "$(OUT)" --preset draft \
		$(if $(FRAMES),--frames $(FRAMES))

# One process more than cores, since some of them always wait; in each one thread for matrices, or they wait for each other.
# A file's tests stay together, since they share what its fixtures made; files keep their order, in which those that render
# come first and none is left to the end.
test: $(VENV)/installed
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test-fast: $(VENV)/installed
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m "not slow"

hard-cases: $(VENV)/installed
	$(BIN)/python -m pytest --quiet --catalogue addon_tests/pure/hard_cases addon_tests/in_blender/hard_cases

# Needs node and Chromium; see CONTRIBUTING.md.
prove-exports: $(VENV)/installed
	npm install --prefix addon_tests/engines --no-package-lock --no-audit --no-fund --silent
	$(BIN)/python addon_tests/engines/prove.py "$(OUT)/prove"

fuzz: $(VENV)/installed
	$(BIN)/python addon_tests/fuzz.py --minutes $(MINUTES)

test-packages: $(TEST_PACKAGES)/installed

test-blender: $(TEST_PACKAGES)/installed
	XIHE_TEST_PACKAGES=$(TEST_PACKAGES) $(BLENDER) --background --factory-startup \
		--python addon_tests/run_in_blender.py -- $(PYTEST_ARGUMENTS)

# The file with windows, which takes longest, begins first; what measures freezes is at its end, when it is alone.
# Two processes: with more than cores, the test of how long the window freezes measures the others.
test-extension: $(VENV)/installed
	XIHE_BLENDER="$(BLENDER)" $(BIN)/python -m pytest -n 2 --dist loadfile addon_tests/real_blender

package: $(VENV)/installed
	$(BIN)/xihe package --out "$(OUT)"

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
	$(BIN)/python addon_tests/bench/sample_count.py
	$(BIN)/python addon_tests/bench/effects.py

scenes: $(VENV)/installed
	$(BIN)/xihe scenes build

# The weights of `lattice` from nothing, and their figures on test rooms. Stopped, the same command goes on. Torch, which only
# training needs, is asked for before hours of rooms.
weights: EXTRAS = test,train
weights: $(VENV)/installed
	@$(BIN)/python -c "import torch" || { echo "Training needs torch: $(BIN)/python -m pip install -e '.[blender,exr,train]'"; exit 1; }
	$(BIN)/xihe dataset build --rooms $(ROOMS) --seed 0 --split train --out $(WEIGHTS)/rooms
	$(BIN)/xihe dataset build --rooms $(ROOMS_BY_DAY) --seed 1 --split train --by-day 1 --out $(WEIGHTS)/rooms_by_day
	$(BIN)/xihe dataset build --rooms $(VARIED_ROOMS) --seed 5 --split train --varied 1 --out $(WEIGHTS)/varied_rooms
	$(BIN)/xihe dataset build --rooms $(OTHER_ROOMS) --seed 0 --split validation --out $(WEIGHTS)/rooms
	$(BIN)/xihe dataset build --rooms $(OTHER_ROOMS) --seed 0 --split test --out $(WEIGHTS)/rooms
	set -e; for target in ldr hdr; do \
		$(BIN)/xihe train --estimator lattice --target $$target --seed 0 --out $(WEIGHTS)/trained \
			--data $(WEIGHTS)/rooms_by_day $(WEIGHTS)/rooms $(WEIGHTS)/varied_rooms \
			--changes 2 --merged-clouds 5 --epochs 8 --batch-size 128 --learning-rate 0.003 --logarithmic-loss; \
		$(BIN)/xihe train export $(WEIGHTS)/trained/lattice_$${target}_0/best.pt $(WEIGHTS)/lattice_$$target.npz \
			$(if $(ELSEWHERE),--elsewhere $(ELSEWHERE),--clouds $(WEIGHTS)/trained/clouds_sphere_1280); \
		$(BIN)/xihe train --report --clouds $(WEIGHTS)/trained/clouds_sphere_1280 --target $$target \
			--network lattice=$(WEIGHTS)/trained/lattice_$${target}_0/best.pt --markdown $(WEIGHTS)/figures_$$target.md; \
	done

clean:
	rm -rf $(VENV) build dist *.egg-info

# Most of what is installed is never imported, so that it is compiled where it is.
$(VENV)/installed: pyproject.toml
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 13)))" || { \
		echo "Blender as a module is for Python 3.11 and 3.13: give make PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[blender,exr,$(EXTRAS)]"
	@$(BIN)/python -c "import bpy" || { echo "Blender's libraries are missing: run '.ci/system_packages' as root (Debian, Ubuntu)"; exit 1; }
	@touch $@

# NumPy is Blender's own: what depends on it is installed alone.
$(TEST_PACKAGES)/installed:
	$(PYTHON) -m pip install --quiet --target $(TEST_PACKAGES) --python-version $(BLENDER_PYTHON) \
		--only-binary=:all: "pytest>=8" "pytest-timeout>=2.3" "hypothesis>=6.100" "pillow>=10" "jsonschema>=4.20"
	$(PYTHON) -m pip install --quiet --target $(TEST_PACKAGES) --python-version $(BLENDER_PYTHON) \
		--only-binary=:all: --no-deps "scipy>=1.11"
	@touch $@
