# make setup | demo | box | test | test-slow | test-minima | mutants | soak | lint | bench  (each sets up .venv first, once)
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# The lowest versions that pyproject.toml allows, and tests that together touch all that telewide calls of each package.
MINIMA := .venv-minima
MINIMA_TESTS := test_records test_options test_npz test_files geometry/test_rig geometry/test_resample capture/test_exif \
	capture/test_images capture/test_raw boards/test_detection calibration/test_bundle calibration/test_rig_file \
	correction/test_colour depth/test_export depth/test_preview pages/test_report cli/test_board cli/test_terminal \
	matching/test_volume matching/test_lite training/test_checkpoint \
	capture/test_heif depth/formats/test_plain_files depth/formats/test_space_files
# make bench RUNS="run other/run" measures their networks too. Four of its six tables need data sets, which you fetch:
#   $(DATA)/middlebury_2006_third/<scene>/{view1,view5,disp1,disp5}.png   vision.middlebury.edu/stereo/data/scenes2006,
#                                                                      the 21 scenes of a third of the size
#   $(DATA)/p30/                                                       captures of a phone, in any layout of the README
DATA   := $(or $(TELEWIDE_DATA),../shared/data)
# Two processes, one thread each; the tests of a file stay together, since they share what they set up.
PARALLEL := -n 2 --dist loadfile
RUN_FLAGS = $(addprefix --run ,$(RUNS))
BOX := $(or $(OUT),box)
BOX_FLAGS = $(if $(FROM),--from $(FROM)) $(if $(DEVICE),--device $(DEVICE)) $(if $(MINUTES),--minutes $(MINUTES)) \
	$(if $(STEPS),--set train.rehearsal.steps=$(STEPS) --set train.rehearsal.least_steps=$(STEPS)) \
	$(addprefix --set ,$(SET))

.PHONY: setup demo box test test-slow test-minima mutants soak lint bench clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,exr,heif,mesh,onnx]'
	touch $@

# From the photos of two unequal lenses to metres: examples/phone holds photos of a board and of six rooms.
demo: $(STAMP)
	$(BIN)/telewide calibrate examples/phone/boards --square-m 0.025 --out demo/rig.yaml
	$(BIN)/telewide run examples/phone/captures --rig demo/rig.yaml --recipe quick --out demo

test: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" $(PARALLEL) $(PYTEST_ARGS)

test-slow: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m slow $(PARALLEL) $(PYTEST_ARGS)

# Old releases warn of what newer ones of others have deprecated: only here are warnings no errors. What is measured on
# photographed data sets is left out: other releases of OpenCV draw other matches.
test-minima: $(MINIMA)/.installed
	OMP_NUM_THREADS=1 $(MINIMA)/bin/python -m pytest -m "not slow and not data" -o filterwarnings= $(PARALLEL) $(MINIMA_TESTS:%=tests/%.py) \
		$(PYTEST_ARGS)

$(MINIMA)/.installed: pyproject.toml constraints.txt .ci/minima
	test -x $(MINIMA)/bin/python || $(PYTHON) -m venv $(MINIMA)
	$(PYTHON) .ci/minima > $(MINIMA)/minima.txt
	$(MINIMA)/bin/python -m pip install --quiet --constraint $(MINIMA)/minima.txt --editable '.[dev,exr,heif,mesh]'
	touch $@

# Bugs planted one at a time: do the tests catch them? make mutants BUGS="training bokeh" plants some lists only.
mutants: $(STAMP)
	$(BIN)/python tests/mutants/run.py $(BUGS)

# Strangers' files by the hundred, and links and pipes around a run folder: no traceback, no hang, nothing else touched.
soak: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python tests/soak.py strangers kill & \
	OMP_NUM_THREADS=1 $(BIN)/python tests/soak.py full closed two many large; others=$$?; wait $$! && exit $$others
	TELEWIDE_MUTATIONS=300 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -o faulthandler_timeout=0 $(PARALLEL) \
		tests/test_fuzz.py tests/test_canary.py

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/mypy

bench: $(STAMP)
	$(BIN)/telewide benchmark speed
	$(BIN)/telewide benchmark metres $(RUN_FLAGS)
	@if test -d "$(DATA)/middlebury_2006_third"; \
	then $(BIN)/telewide benchmark middlebury "$(DATA)/middlebury_2006_third" --split test $(RUN_FLAGS); \
	else echo "left out: no Middlebury 2006 scenes at $(DATA)/middlebury_2006_third; see the head of the Makefile" >&2; fi
	@if test -d "$(DATA)/p30"; \
	then $(BIN)/telewide benchmark matches "$(DATA)/p30" --uncorrected $(RUN_FLAGS) && \
	$(BIN)/telewide benchmark marks "$(DATA)/p30" --marks tests/benchmark/p30_marks.yaml $(RUN_FLAGS) && \
	$(BIN)/telewide benchmark bokeh "$(DATA)/p30" $(RUN_FLAGS); \
	else echo "left out: no captures at $(DATA)/p30; see the head of the Makefile" >&2; fi

# Continues where it was stopped; some hours bring it near its end. On a GPU for a quarter of an hour, repeated until
# it is done:  make box FROM=box MINUTES=14 DEVICE=cuda STEPS=20000 SET="train.crop_hw=[256,512]"
box: $(STAMP)
	$(BIN)/telewide train --recipe box --out $(BOX) $(BOX_FLAGS)

clean:
	rm -rf demo dist .mypy_cache .pytest_cache .ruff_cache
