# Everything a contributor runs. `make test`, `make demo` and `make play` need nothing but python3 (3.11 or newer) and make.
PYTHON ?= python3
# Processes that test: one for each processor, four at most, because each takes up to 3 GB.
WORKERS ?= logical
PORT ?= 8080
BIN := .venv/bin
PARALLEL = -n $(WORKERS) --maxprocesses 4 --dist worksteal

.PHONY: test test-all lint types pytest pytest-all docs notebooks demo play serve lock clean

# What checks files needs one processor, next to the tests.
test: .venv/.installed
	$(MAKE) --jobs=2 pytest lint types docs

# With browsers, whole experiments, the README's examples and the notebooks.
test-all: .venv/.installed
	$(MAKE) --jobs=2 pytest-all lint types docs

lint: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/.installed
	$(BIN)/pyright --pythonpath $(BIN)/python

pytest: .venv/.installed
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow" tests

pytest-all: .venv/.installed
	$(BIN)/python -m pytest $(PARALLEL) --nbmake tests notebooks

docs: .venv/.installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir site

# The copies that the documentation shows.
notebooks: .venv/.installed
	$(BIN)/jupyter nbconvert --to notebook --execute --ExecutePreprocessor.record_timing=False --output-dir docs/notebooks \
	  notebooks/*.ipynb

demo: .venv/.installed
	$(BIN)/pfnn-jax demo --out demo --overwrite

# A character to drive in the browser, in the styles of the package's base network.
play: .venv/.installed
	$(BIN)/pfnn-jax play --port $(PORT)

serve: .venv/.installed
	$(BIN)/mkdocs serve

# Writes the lock file again; needs uv. The lock names no package index and serves every supported Python.
lock:
	uv pip compile pyproject.toml --extra test --extra docs --extra notebooks --extra experiments --group build --upgrade \
	  --universal --python-version 3.11 --fork-strategy fewest \
	  --no-header --no-emit-index-url --no-annotate --quiet -o requirements.lock

clean:
	rm -rf .venv site demo .pytest_cache .ruff_cache .hypothesis .jax_cache

# Two stamps: a changed lock file rebuilds the environment, a changed pyproject.toml installs the project again.
.venv/.locked: requirements.lock
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed, this is " + sys.version if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	touch $@

.venv/.installed: .venv/.locked pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@
