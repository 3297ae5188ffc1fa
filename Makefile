# make run: set up, then do the main job on the sample logs.  make test: set up, then the tests.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

.PHONY: run test check samples clean

run: $(READY)
	$(BIN)/bcid run

test: $(READY)
	$(BIN)/pytest -q -n 2 --dist loadfile

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

samples: $(READY)
	$(BIN)/bcid simulate --sample-logs sample_logs --seed 1

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt torch
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $(READY)

clean:
	rm -rf .venv workspace bcid/__pycache__/numba
