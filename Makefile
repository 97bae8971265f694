# make setup | demo | demo-phone | test | test-slow | lint | bench        (each sets up .venv first, once)
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# make bench RUNS="run other/run" measures their networks too; TELEWIDE_DATA is where the data sets lie.
DATA   := $(or $(TELEWIDE_DATA),../shared/data)
RUN_FLAGS = $(addprefix --run ,$(RUNS))

.PHONY: setup demo demo-phone test test-slow lint bench clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: $(STAMP)
	$(BIN)/telewide run examples/captures --recipe quick --out demo

# From the photos of two unequal lenses, simulated with a board: calibrate, then the same in metres.
demo-phone: $(STAMP)
	$(BIN)/telewide simulate demo-phone --phone --captures 6 --width 720 --seed 1
	cd demo-phone && ../$(BIN)/telewide calibrate --square-m 0.025
	cd demo-phone && ../$(BIN)/telewide run captures --recipe quick

test: $(STAMP)
	$(BIN)/python -m pytest -m "not slow" $(PYTEST_ARGS)

test-slow: $(STAMP)
	$(BIN)/python -m pytest -m slow $(PYTEST_ARGS)

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
	rm -rf demo demo-phone dist .mypy_cache .pytest_cache .ruff_cache
