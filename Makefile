# make run: set up, then do the main job on the sample logs.  make test: set up, then the tests that take less than ten seconds each
# (make slow: those that take more, make proofs: those that take minutes).
# make wheel: the wheel, installed and run.  make versions: tests under every version of Python (VERSIONS="3.12" for one).
# make fuzz N=10000, make kills N=200: mutants of every kind of file, kills of a whole pipeline; figures to docs/results/faults.json.
# make faults: both, flipped bits, the conformance suite and files that expand, and docs/recordings.md of them.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

N ?= 1000

.PHONY: run test slow proofs fuzz kills faults check wheel versions samples clean

run: $(READY)
	$(BIN)/bcid run

# a worker for each core: their kernels would fight
test: $(READY)
	NUMBA_NUM_THREADS=1 $(BIN)/pytest -q -n 2 --dist loadfile -m "not slow and not proof"

slow: $(READY)
	NUMBA_NUM_THREADS=1 $(BIN)/pytest -q -n 2 --dist loadfile -m slow

proofs: $(READY)
	NUMBA_NUM_THREADS=1 $(BIN)/pytest -q -n 2 -m proof

fuzz kills: $(READY)
	PYTHONPATH=tests $(BIN)/python -m faults $@ --n $(N) --out docs/results/faults.json

# all counts that docs/recordings.md tells, and the page itself: hours
faults: $(READY)
	PYTHONPATH=tests $(BIN)/python -m faults counts $(if $(BCID_RECORDINGS),--recordings $(BCID_RECORDINGS)) --out docs/results/faults.json
	PYTHONPATH=tests $(BIN)/python -m faults battery --out docs/results/faults.json
	$(MAKE) fuzz N=10000
	$(MAKE) kills N=200
	cd tests && ../$(BIN)/python -m catalogue > ../docs/recordings.md

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32  # as it would run there
	$(BIN)/lint-imports

# built, installed where nothing of this checkout is in reach, and run
wheel: $(READY)
	$(BIN)/python tests/try_wheel.py

# tests that depend on the version of Python, under all that bcid is for and that are to be had: minutes each
versions: $(READY)
	$(BIN)/python tests/try_versions.py $(VERSIONS)

samples: $(READY)
	$(BIN)/bcid simulate --sample-logs sample_logs --seed 1 --force

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt torch
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e ".[networks,checks,export,fleet,dev]"
	touch $(READY)

clean:
	rm -rf .venv .venv-3.* workspace bcid/__pycache__/numba
