# Needs Python >= 3.11, make and git. Everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.setup-done

.PHONY: setup demo test test-all check bench budget certify clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt requirements-speech.txt
	@$(PYTHON) -c 'import sys; sys.exit(f"Downbeat needs Python >= 3.11, {sys.executable} is {sys.version.split()[0]}; say e.g. make PYTHON=python3.12" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv pip install --quiet --python $(BIN)/python --constraints constraints.txt -e '.[dev,listen,speech]'
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps -r requirements-speech.txt
	@touch $@

demo: setup
	$(BIN)/downbeat demo $(ARGS)

test: setup
	$(BIN)/python -m pytest $(ARGS)

test-all: setup
	$(BIN)/python -m pytest -m "not net and not gpu and not hardware" $(ARGS)

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	PYTHONPATH=.ns $(BIN)/lint-imports --no-cache

bench: setup
	$(BIN)/downbeat bench $(ARGS)

# Of the newest run; ARGS names another.
budget: setup
	$(BIN)/downbeat budget $(ARGS)

certify: setup
	$(BIN)/downbeat policy certify --all $(ARGS)

clean:
	rm -rf $(VENV) build dist runs .cache *.egg-info .mypy_cache .ruff_cache .pytest_cache
