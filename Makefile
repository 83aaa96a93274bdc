# The commands that people type. `make` alone lists them.
.DEFAULT_GOAL := help
SHELL := /bin/bash
.PHONY: help setup setup-all build demo test test-fast lint lint-rules lint-format lint-types lint-spelling lint-imports lint-architecture lint-figures architecture format bench docs wheel lock audit sbom soak clean distclean

# Choices, also taken from the environment; see tools/bootstrap.sh --help.
PYTHON ?=
LITSIM_TORCH ?=
TORCH_INDEX ?=
export PYTHON LITSIM_TORCH TORCH_INDEX

# Passed on to pytest, for example: make test ARGS="-k takeover -x"
ARGS ?=
# Processes of pytest: more than there are cores, since tests of the graph mostly wait.
JOBS ?= $(shell expr 2 + $$(nproc))

BIN := .venv/bin
SOURCES := $(shell printf '%s:' src/litsim*)

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo "  make test-AREA  the tests of one folder of tests/: $(patsubst tests/%/,%,$(filter-out %/__pycache__/ %/soak/,$(wildcard tests/*/)))"
	@echo "  ./litsim        run one executable; alone, it lists them"
	@echo "Variables: PYTHON, LITSIM_TORCH=cpu|gpu|none, TORCH_INDEX (tools/bootstrap.sh --help); ARGS, JOBS for pytest"

setup: ## what runs need, into .venv: Python packages and ROS 2 Jazzy
	@tools/bootstrap.sh
setup-all: ## setup, and torch for training, and all that tests, lint and maps need
	@tools/bootstrap.sh --all

build: setup ## setup, then the ROS 2 workspace, into build/ and install/
	@tools/build.sh

demo: build ## the embedded scenario, closed loop: the ego brakes, drives on; leaves bags/demo
	./litsim launch --scenario demo --ego perturbed --set ego.kind=brake ego.deceleration=3 ego.duration=3 "ego.time=[8.0, 8.0]" \
	  --policy litsim --out bags/demo --overwrite

# Each process reads all tests: half of that time goes into their assertions, where no bytecode of them is kept.
test: setup-all build ## every test, in JOBS processes; prints the slowest
	PYTHONDONTWRITEBYTECODE= ./litsim exec python -m pytest -n $(JOBS) --dist worksteal --durations=20 $(ARGS)
test-fast: setup-all build ## the quick tests: no graph, browser, training or campaign (tests/slow.txt)
	PYTHONDONTWRITEBYTECODE= ./litsim exec python -m pytest --fast -n $(JOBS) --dist worksteal $(ARGS)
test-%: setup-all build
	PYTHONDONTWRITEBYTECODE= ./litsim exec python -m pytest -n $(JOBS) --dist worksteal tests/$* $(ARGS)

lint: lint-rules lint-format lint-types lint-spelling lint-imports lint-architecture lint-figures ## ruff, mypy, codespell, import-linter
lint-rules: setup-all
	$(BIN)/ruff check
lint-format: setup-all
	$(BIN)/ruff format --check
lint-types: setup-all
	$(BIN)/mypy
lint-spelling: setup-all
	$(BIN)/codespell
lint-imports: setup-all
	PYTHONPATH=$(SOURCES) $(BIN)/lint-imports
lint-architecture: setup-all
	PYTHONPATH=$(SOURCES) $(BIN)/python tools/architecture.py --check
lint-figures: setup-all
	$(BIN)/python tools/figures.py --check

architecture: setup-all ## draw the imports between folders into ARCHITECTURE.md
	PYTHONPATH=$(SOURCES) $(BIN)/python tools/architecture.py

format: setup-all ## put the sources into the format that lint asks for
	$(BIN)/ruff check --fix-only --quiet
	$(BIN)/ruff format

bench: build ## what a step costs on this machine, by stage, beside highway-env
	@benchmarks/highway_env/setup.sh || echo "bench: without highway-env"
	./litsim bench $(if $(wildcard benchmarks/highway_env/.venv/.ready),--highway-env benchmarks/highway_env) $(ARGS)

soak: build ## 100 short runs of the graph, resumed where they were left; docs/performance.md
	./litsim exec python tests/soak/soak.py $(ARGS)

DOCS = $(BIN)/uv run --quiet --no-project --python $(BIN)/python --with-requirements requirements/locked/docs.txt
docs: setup ## the site of the documentation, with the Python reference, into build/site/; links and anchors are checked
	@$(BIN)/python tools/site.py
	@$(DOCS) --offline true 2>/dev/null || $(DOCS) true # packages are asked for once
	@$(DOCS) --offline zensical build --strict
	@echo "build/site/index.html: python3 -m http.server --directory build/site"

wheel: setup ## what pip installs, without ROS, into dist/; built twice, and equal to the byte
	@rm -rf dist build/again
	@for out in dist build/again; do SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) \
	  $(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir $$out . || exit 1; done
	@cmp dist/*.whl build/again/*.whl && sha256sum dist/*.whl

lock: ## versions and hashes of all packages, from constraints.txt, into requirements/locked/
	@tools/lock.sh

audit: ## known vulnerabilities of the pinned packages, by pip-audit; fails where it cannot ask
	$(BIN)/uv tool run --quiet --from pip-audit==2.10.1 pip-audit --strict --disable-pip --no-deps -r requirements/constraints.txt

sbom: ## what is installed, as CycloneDX, into sbom.json
	$(BIN)/uv tool run --quiet --from cyclonedx-bom==7.5.0 cyclonedx-py environment --output-reproducible --of JSON -o sbom.json .venv

clean: ## remove what build made
	rm -rf build dist install log
	find src \( -name '*.nb[ic]' -o -name '*.kernel' \) -delete

distclean: clean ## remove the environment and every cache as well
	rm -rf .venv .cache .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
