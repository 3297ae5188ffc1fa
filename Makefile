# make run: set up, then do the main job on the sample logs.  make test: set up, then the tests (make proofs: those that take minutes).
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

.PHONY: run test proofs check samples clean

run: $(READY)
	$(BIN)/bcid run

test: $(READY)
	NUMBA_NUM_THREADS=1 $(BIN)/pytest -q -n 2 --dist loadfile  # a worker for each core: their kernels would fight

proofs: $(READY)
	NUMBA_NUM_THREADS=1 $(BIN)/pytest -q -n 2 -m proof

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
