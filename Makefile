# make setup | demo | test | test-slow | mutants | lint | bench        (each sets up .venv first, once)
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# make bench RUNS="run other/run" measures their networks too; TELEWIDE_DATA is where the data sets lie.
DATA   := $(or $(TELEWIDE_DATA),../shared/data)
RUN_FLAGS = $(addprefix --run ,$(RUNS))

.PHONY: setup demo test test-slow mutants lint bench clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

# From the photos of two unequal lenses to metres: examples/phone holds photos of a board and of six rooms.
demo: $(STAMP)
	$(BIN)/telewide calibrate examples/phone/boards --square-m 0.025 --out demo/rig.yaml
	$(BIN)/telewide run examples/phone/captures --rig demo/rig.yaml --recipe quick --out demo

test: $(STAMP)
	$(BIN)/python -m pytest -m "not slow" $(PYTEST_ARGS)

test-slow: $(STAMP)
	$(BIN)/python -m pytest -m slow $(PYTEST_ARGS)

# Bugs planted one at a time: do the tests catch them? make mutants BUGS="training bokeh" plants some lists only.
mutants: $(STAMP)
	$(BIN)/python tests/mutants/run.py $(BUGS)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(STAMP)
	$(BIN)/telewide benchmark speed
	@if test -d "$(DATA)/middlebury_2006_third"; \
	then $(BIN)/telewide benchmark middlebury "$(DATA)/middlebury_2006_third" --split test $(RUN_FLAGS); \
	else echo "no Middlebury 2006 scenes in $(DATA): set TELEWIDE_DATA" >&2; fi
	@if test -d "$(DATA)/p30"; \
	then $(BIN)/telewide benchmark matches "$(DATA)/p30" --uncorrected $(RUN_FLAGS); \
	else echo "no phone pairs in $(DATA): set TELEWIDE_DATA" >&2; fi

clean:
	rm -rf demo dist .mypy_cache .pytest_cache .ruff_cache
