# make            install into .venv (again after a change of the C++ or the dependencies)
# make demo       train, evaluate and film a short landing run into runs/demo
# make test       style, import contracts, types and tests
# make lint       style, formatting, import contracts and types
# make bench      simulation speed
# make diagram    docs/architecture.svg, drawn from the imports
# make docs       the documentation site in build/site, every link in it checked
# make wheel      sdist and Linux wheel in dist: installed from there, no compiler is needed
#
# PYTHON=python3.12  the interpreter to build .venv with
# PIP_ARGS=...       extra arguments for pip (constraints.txt says how to choose a torch build)

PYTHON ?= python3
PIP_ARGS ?=
BIN := .venv/bin
INSTALLED := .venv/.installed
MACHINE := $(shell uname -m)
GLIBC := 2.27
# The type checker does not see through the editable installation: it gets the folders as the package.
TYPES = mkdir -p .venv/types/inclined_landing && touch .venv/types/inclined_landing/__init__.py \
  && ln -sfn $(CURDIR)/models $(CURDIR)/envs .venv/types/inclined_landing \
  && MYPYPATH=.venv/types $(BIN)/mypy --cache-dir .venv/mypy -p inclined_landing.models -p inclined_landing.envs
SOURCES := pyproject.toml constraints.txt models/crazyflie.toml $(wildcard models/plugin/*)

.PHONY: install demo test lint bench diagram docs wheel
install: $(INSTALLED)

demo: $(INSTALLED)
	rm -rf runs/demo
	$(BIN)/landing-train landing --out runs/demo --seed 0
	$(BIN)/landing-eval video runs/demo/final.zip --out runs/demo/landing.mp4 --gif \
	  --camera hero --start 1.5,1.8 --start 0,2 --start=-1.5,1.6

test: $(INSTALLED)
	$(BIN)/ruff check
	$(BIN)/lint-imports --no-logo
	$(TYPES)
	$(BIN)/pytest -n 2 --dist loadfile

lint: $(INSTALLED)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports --no-logo
	$(TYPES)

bench: $(INSTALLED)
	$(BIN)/landing-eval benchmark

diagram: $(INSTALLED)
	$(BIN)/python docs/diagram.py

docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Zig's C++ compiler, from the package index, links against the oldest C library that MuJoCo's own wheel runs
# with: so one wheel serves all Linuxes that MuJoCo serves, wherever it is built. libmujoco is MuJoCo's.
wheel: $(INSTALLED)
	$(BIN)/pip install -q $(PIP_ARGS) -c constraints.txt -e '.[wheel]'
	rm -rf dist build/wheel
	CXX="$(CURDIR)/$(BIN)/python -m ziglang c++ -target $(MACHINE)-linux-gnu.$(GLIBC)" \
	  $(BIN)/python -m build --outdir build/wheel
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/auditwheel repair --exclude 'libmujoco.so.*' \
	  --only-plat --plat manylinux_$(subst .,_,$(GLIBC))_$(MACHINE) --wheel-dir dist build/wheel/*.whl
	mv build/wheel/*.tar.gz dist

$(INSTALLED): $(SOURCES)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
	  { echo "error: $(PYTHON) is missing or older than Python 3.11; name another one with" \
	         "'make PYTHON=python3.12'." >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	  { echo "error: $(PYTHON) cannot create virtual environments; install its venv module" \
	         "(on Debian and Ubuntu: apt install python3-venv)." >&2; exit 2; }
	@for compiler in "$$CXX" c++ g++ clang++; do command -v "$$compiler" >/dev/null && exit 0; done; \
	  echo "error: no C++ compiler was found for the native plugins; install one (on Debian and" \
	       "Ubuntu: apt install g++) or name it in CXX." >&2; exit 2
	$(PYTHON) -m venv .venv
	$(BIN)/pip install $(PIP_ARGS) -c constraints.txt -e '.[all,test]'
	@touch $@
