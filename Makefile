# Two commands do everything, their own set-up included: `make reproduce` and `make test`.

VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
OUT ?= results

# What `make reproduce` estimates: RECORDING=…, else a public recording that stands beside the
# checkout, else a motion in closed form.
PUBLIC := $(wildcard ../shared/data/spacetime/slow_free_space)
RECORDING ?= $(if $(PUBLIC),$(PUBLIC),$(OUT)/closed_form)
WINDOW ?= $(if $(filter $(PUBLIC),$(RECORDING)),19 29)

export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

.PHONY: reproduce test lint check-types check-layers pytest bench picture clean

reproduce: $(READY)
	$(if $(filter $(OUT)/closed_form,$(RECORDING)),$(BIN)/python examples/closed_form_motion.py $(OUT)/closed_form)
	$(BIN)/glissando estimate $(RECORDING) $(if $(WINDOW),--window $(WINDOW)) --out $(OUT)

test: lint check-types check-layers pytest

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

check-types: $(READY)
	$(BIN)/mypy

check-layers: $(READY)
	$(BIN)/lint-imports --no-cache

pytest: $(READY)
	$(BIN)/pytest -q -n 2

bench: $(READY)
	$(BIN)/python benchmarks/estimate.py

picture: $(READY)
	$(BIN)/python examples/closed_form_motion.py $(OUT)/closed_form
	$(BIN)/glissando estimate $(OUT)/closed_form --out $(OUT)/closed_form_estimate
	cp $(OUT)/closed_form_estimate/shape.png docs/images/shape.png
	cp $(OUT)/closed_form_estimate/confidence.png docs/images/confidence.png

$(READY): pyproject.toml
	python3 -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	touch $(READY)

clean:
	rm -rf $(VENV) $(OUT)
