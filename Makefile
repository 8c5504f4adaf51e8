# Three commands do everything, their own set-up included: `make reproduce`, `make test` and, before
# a release, `make release`.

VENV := .venv
BIN := $(VENV)/bin
TOOLS := .release
READY := $(VENV)/.ready
OUT ?= results

# What `make reproduce` estimates in the end: RECORDING=…, else a public recording that stands
# beside the checkout, else a simulated one.
PUBLIC := $(wildcard ../shared/data/spacetime/slow_free_space)
RECORDING ?= $(if $(PUBLIC),$(PUBLIC),$(OUT)/simulated)
WINDOW ?= $(if $(filter $(PUBLIC),$(RECORDING)),19 29)

export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

.PHONY: reproduce release lock test checks lint check-types check-layers promises docs pytest bench picture clean

reproduce: $(READY)
	$(BIN)/glissando reproduce --out $(OUT)
	rm -rf $(OUT)/simulated
	$(BIN)/glissando simulate --shape S --slide oscillate --out $(OUT)/simulated
	$(BIN)/glissando estimate $(RECORDING) $(if $(WINDOW),--window $(WINDOW)) --out $(OUT)/estimate

test: checks pytest

# Two at a time: types and the site take longest.
checks: $(READY)
	$(MAKE) --no-print-directory -j 2 check-types docs lint check-layers promises

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell

check-types: $(READY)
	$(BIN)/mypy

check-layers: $(READY)
	$(BIN)/lint-imports --no-cache

# Every public promise and the tests that show it; one without is an error.
promises: $(READY)
	$(BIN)/python tests/support/promises.py

# The site, from the pages in docs/ and the docstrings, in site/; a warning is an error.
docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

pytest: $(READY)
	$(BIN)/pytest -q -n 2 --dist worksteal -m "not alone"
	$(BIN)/pytest -q -n 2 -m alone tests/hardware

bench: $(READY)
	$(BIN)/python benchmarks/estimate.py
	$(BIN)/python benchmarks/simulate.py

# The page docs/reproduction, its figures, the picture of the README, those of the tutorials.
picture: $(READY)
	$(BIN)/glissando reproduce --out docs/reproduction
	$(BIN)/python benchmarks/tutorials.py

# What is committed, built twice and tried out: see docs/release.md.
release: $(TOOLS)/.ready
	$(TOOLS)/bin/python release/check.py

# The tested set of packages and its bill of materials, anew.
lock: $(TOOLS)/.ready
	$(TOOLS)/bin/python release/lock.py

$(TOOLS)/.ready: release/tools.txt
	python3 -m venv $(TOOLS)
	$(TOOLS)/bin/python -m pip install --quiet --requirement release/tools.txt
	touch $@

$(READY): pyproject.toml
	python3 -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	$(BIN)/python -m pip install --quiet --prefer-binary --editable '.[ros2]' \
	  || echo "ROS 2 has no wheels for this Python and system; its tests are skipped."
	touch $(READY)

clean:
	rm -rf $(VENV) $(TOOLS) $(OUT) dist site
