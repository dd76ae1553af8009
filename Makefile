# The course, from a clone: `make lab` to read it, `make depth` for the result alone, `make help` for the rest.
# Needs Python 3.11 or newer with venv. Another interpreter: make lab PYTHON=python3.12
# TORCH=cpu takes torch's CPU build, TORCH=auto the one for this machine's GPU, by uv; otherwise pip's default.

PYTHON ?= python3
BIN := .venv/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
READY := .venv/.installed
DEV_READY := .venv/.installed-dev
RENDER := .venv-render/bin
RENDER_READY := .venv-render/.installed

NBVAL := --nbval --nbval-current-env --nbval-sanitize-with=tests/nbval_sanitize.cfg --nbval-cell-timeout=600
# One worker more than cores, since some tests wait. In the order of the files: by size, the longest would come last.
WORKERS = -n $(shell $(PYTHON) -c "import os; print(min(4, 1 + os.cpu_count()))") --dist loadscope --no-loadscope-reorder
define LINT
$(BIN)/ruff check .
$(BIN)/ruff format --check .
$(BIN)/mypy
endef

# glibc would give large arrays back to the system, which clears pages for the next ones. Threads that wait would spin,
# and keep the cores from the other workers.
SHARED := MALLOC_MMAP_MAX_=0 MALLOC_TRIM_THRESHOLD_=1000000000 OMP_WAIT_POLICY=passive

define CHECK_PYTHON
import sys
if sys.version_info < (3, 11):
    sys.exit("The course needs Python 3.11 or newer; $(PYTHON) is %d.%d. With another one: make PYTHON=python3.12" % sys.version_info[:2])
endef
export CHECK_PYTHON

.DEFAULT_GOAL := help
.PHONY: help lab fresh progress depth demo doctor test check test-all coverage grade render bench results notebooks solutions book slides constraints clean

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

lab: $(READY)  ## JupyterLab on your copies of the notebooks, in my_notebooks; LAB_ARGS: more options
	$(BIN)/python -m course lab -- $(LAB_ARGS)

fresh: $(READY)  ## a fresh copy of one notebook: make fresh NOTEBOOK=03; yours is kept beside it
	$(if $(NOTEBOOK),,$(error Say which notebook: make fresh NOTEBOOK=03))
	$(BIN)/python -m course fresh $(NOTEBOOK)

progress: $(READY)  ## which of your functions are right, across the notebooks: out/progress.html
	$(BIN)/python -m course progress

depth: $(READY)  ## the sample frame, or your own: RIG=rig.yaml IMAGES="1.png 2.png 3.png 4.png" make depth
	$(BIN)/omnistereo depth $(if $(RIG),--rig '$(RIG)') $(if $(IMAGES),--images $(IMAGES)) $(DEPTH_ARGS)

demo: $(READY)  ## a drive through the bundled streets, panorama and depth live in the browser
	$(BIN)/omnistereo demo

doctor:  ## checks Python, the packages and the data, and says how to fix what is wrong
	@$$($(BIN)/python -c pass 2>/dev/null && echo $(BIN)/python || echo $(PYTHON)) -m course doctor

test: $(DEV_READY)  ## six minutes: linters, types, every notebook, the library, the checkers, README's commands
	$(LINT)
	$(SHARED) $(BIN)/python -m pytest $(WORKERS) $(NBVAL) -m "not slow and not browser and not nightly"

check: $(DEV_READY)  ## a minute: linters, types, the library's tests, one notebook
	$(LINT)
	$(SHARED) $(BIN)/python -m pytest $(WORKERS) $(NBVAL) -m "not slow" tests/lib tests/test_package.py notebooks/03_sphere_sweep.ipynb

test-all: $(DEV_READY)  ## everything: also all pages as typed, a browser, the book, fuzzing, kills; PART="-m browser": a part
	$(LINT)
	$(SHARED) $(BIN)/python -m pytest $(WORKERS) $(NBVAL) $(PART)

# Apart from `test-all`, which it would slow by a half; without the fuzzer, whose limits it breaks.
coverage: $(DEV_READY)  ## the lines of the library that the tests reach
	$(SHARED) $(BIN)/python -m pytest $(WORKERS) --cov -m "not nightly" tests

grade: $(if $(CONTAINER),,$(READY))  ## score sheets of handed-in notebooks, whose code it runs: make grade HANDED_IN=folder [CONTAINER=docker]
	$(if $(HANDED_IN),,$(error Say what to check, see book/teaching.md: make grade HANDED_IN=folder))
ifeq ($(CONTAINER),)
	$(BIN)/python -m course check '$(HANDED_IN)' $(GRADE_ARGS)
else
	$(CONTAINER) build --tag course-check --file course/classroom/Dockerfile .
	mkdir -p out/checked && chmod a+w out/checked
	$(CONTAINER) run --rm --network none --read-only --tmpfs /tmp:exec --env HOME=/tmp --memory 6g --pids-limit 512 \
	  --cap-drop ALL --security-opt no-new-privileges \
	  --volume "$$(realpath '$(HANDED_IN)'):/handed-in:ro" --volume '$(CURDIR)/out/checked:/checked' \
	  course-check python -m course check /handed-in --out /checked $(GRADE_ARGS)
endif

render: $(RENDER_READY)  ## renders what is missing of sunny/test, or RENDER_ARGS="sunny/train --frames 500 --out more"
	$(RENDER)/python -m workshop.render $(RENDER_ARGS)

bench: $(READY)  ## speed, as ratios against named alternatives
	$(BIN)/python -m workshop bench $(BENCH_ARGS)

results: $(DEV_READY)  ## the stored results and the reproduction report again: hours, but it resumes
	$(BIN)/python -m workshop results -- $(RESULTS_ARGS)

notebooks: $(READY)  ## runs all notebooks and stores them, with their stills and the lists on the pages
	$(BIN)/python -m workshop run notebooks/*.ipynb
	$(BIN)/python -m workshop stills notebooks/*.ipynb
	$(BIN)/python -m workshop pages

solutions: $(READY)  ## the notebooks with every exercise solved, run, into out/solutions: ten minutes
	$(BIN)/python -m course solve

book: $(DEV_READY)  ## the course as a website, which works offline: out/book/index.html
	$(BIN)/python -m workshop book

slides: $(DEV_READY)  ## slides of every notebook, which work offline: out/slides; NOTEBOOK=03: of one, and as PDF
	$(BIN)/python -m workshop slides $(if $(NOTEBOOK),--notebook $(NOTEBOOK) --pdf)

constraints: $(DEV_READY)  ## pins what came along with environment.txt
	@{ echo "# What the packages of environment.txt and environment-dev.txt bring along, pinned. Written by: make constraints"; \
	  echo "# Nothing of CUDA stands here: whether torch needs it depends on the build that pip finds."; \
	  grep -hv '^-' environment.txt environment-dev.txt > .venv/direct.txt; \
	  $(BIN)/pip freeze --exclude-editable -r .venv/direct.txt | sed '1,/^## /d' \
	  | grep -ivE '^(nvidia|cuda|triton)|[ +]|@'; } > constraints.txt.tmp
	@mv constraints.txt.tmp constraints.txt

clean:  ## removes what the other targets made, the environments included
	rm -rf .venv .venv-render out .pytest_cache .ruff_cache .mypy_cache .hypothesis .coverage* omnistereo_lib.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

define INSTALL
@$(PYTHON) -c "$$CHECK_PYTHON"
@test -x $(BIN)/pip || $(PYTHON) -m venv --clear .venv
@echo "Installing the packages of $< into .venv; once, a minute or two."
@$(BIN)/python -m pip install --quiet --disable-pip-version-check $(if $(TORCH),uv,-r $<)
@$(if $(TORCH),$(BIN)/uv pip install --quiet --python $(BIN)/python --torch-backend $(TORCH) -r $<)
@touch $@
endef

$(READY): environment.txt constraints.txt pyproject.toml
	$(INSTALL)

$(DEV_READY): environment-dev.txt environment.txt constraints.txt pyproject.toml
	$(INSTALL)

$(RENDER_READY): environment-render.txt
	@$(PYTHON) -c "$$CHECK_PYTHON"
	@test -x $(RENDER)/pip || $(PYTHON) -m venv --clear .venv-render
	@$(RENDER)/python -m pip install --quiet --disable-pip-version-check -r environment-render.txt
	@touch $@
