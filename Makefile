# `make demo` and `make test` do all the set-up on a fresh machine; a second call only repeats the work.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out

.PHONY: demo test nightly smoke lint docs bench matrix notebooks setup clean

demo: $(VENV)/.installed
	$(BIN)/pinwm demo --out $(OUT)/demo

# Most tests keep one core busy; those of a file share what they set up. Not reordered by the number of a file's tests:
# those of few and long ones, such as the notebooks, would come last, and one core would wait for the other.
# One core compiles the kernels of the physics; mypy runs on the other, and then those of the renderer are compiled.
test: $(VENV)/.installed
	$(MAKE) --no-print-directory --jobs 2 smoke-physics lint smoke-rendering
	$(BIN)/pytest --numprocesses auto --dist loadfile --no-loadscope-reorder

nightly: $(VENV)/.installed
	$(BIN)/pytest -m nightly

smoke: $(VENV)/.installed
	$(BIN)/python .ci/smoke.py

smoke-%: $(VENV)/.installed
	$(BIN)/python .ci/smoke.py $*

lint: $(VENV)/.installed
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

# The site, in $(OUT)/site; a warning is an error.
docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir $(OUT)/site

bench: $(VENV)/.installed-bench
	$(BIN)/python -m benchmarks

# Python 3.11 to 3.13, newest and oldest allowed versions: hours. `.ci/matrix PART ...` runs some of it.
matrix: $(VENV)/.installed
	.ci/matrix

# Execute the notebooks, and store them with their outputs.
notebooks: $(VENV)/.installed
	$(BIN)/python notebooks/execute.py

setup: $(VENV)/.installed

# Work is stamped by the files that decide what gets installed.
$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[dev]"
	touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[docs]"
	touch $@

$(VENV)/.installed-bench: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[dev,bench]"
	touch $@

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; v = sys.version.split()[0]; sys.exit(None if sys.version_info >= (3, 11) else "$(PYTHON) is Python " + v + "; allowed: 3.11 or newer, as in: make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)

clean:
	rm -rf $(VENV) $(OUT)
