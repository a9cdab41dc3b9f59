# make            install into .venv what training and evaluation need (again after a change of C++ or dependencies)
# make demo       train, evaluate and film a short landing run into runs/demo
# make test       style, wording, import contracts, types and the tests: about five minutes
# make test-all   the slow tests too, and those that need OpenGL, a browser or an extra: an hour
# make lint       style, formatting, wording, import contracts and types
# make bench      simulation speed
# make docs       the documentation site in build/site, every link in it checked
# make wheel      sdist and Linux wheel in dist: installed from there, no compiler is needed
# make release    the same, and whether they are fit to be published: one line for each check
# make lock       constraints.txt: exact versions that go together on every supported Python
#
# PYTHON=python3.12  the interpreter to build .venv with
# TORCH=default      PyTorch as your package index has it; on Linux that brings gigabytes of CUDA along
# PIP_ARGS=...       extra arguments for pip

PYTHON ?= python3
PIP_ARGS ?=
TORCH ?= cpu
CPU_BUILDS := https://download.pytorch.org/whl/cpu
BIN := .venv/bin
PIP = $(BIN)/pip --disable-pip-version-check install $(PIP_ARGS) -c constraints.txt
# One file for each group of dependencies (an extra of pyproject.toml) that is installed.
INSTALLED := .venv/.installed-all
PYTEST = $(BIN)/pytest -n logical --maxprocesses 8 --dist worksteal
OLDEST := 3.11.0
MACHINE := $(shell uname -m)
GLIBC := 2.27
# The type checker does not see through the editable installation: it gets the folders as the package.
PACKAGES := models envs eval train
TYPES = mkdir -p .venv/types/inclined_landing && touch .venv/types/inclined_landing/__init__.py \
  && ln -sfn $(addprefix $(CURDIR)/,$(PACKAGES)) .venv/types/inclined_landing \
  && MYPYPATH=.venv/types $(BIN)/mypy --cache-dir .venv/mypy $(addprefix -p inclined_landing.,$(PACKAGES))
SOURCES := pyproject.toml constraints.txt models/crazyflie.toml $(wildcard models/plugin/*)

.PHONY: install demo test test-all checks lint bench docs wheel release lock
install: $(INSTALLED)

demo: $(INSTALLED)
	rm -rf runs/demo
	$(BIN)/landing-train landing --out runs/demo --seed 0
	$(BIN)/landing-eval video runs/demo/final.zip --out runs/demo/landing.mp4 --gif --width 640 --height 360 \
	  --start 1.5,1.8 --start 0,2 --start=-1.5,1.6

# Checks and compiling run side by side.
test: .venv/.installed-test
	@$(MAKE) --no-print-directory -j 2 checks .venv/.compiled
	$(PYTEST)

checks: .venv/.installed-test
	$(BIN)/ruff check
	$(BIN)/lint-imports --no-logo
	$(BIN)/python .ci/words.py
	$(TYPES)

test-all: .venv/.installed-test-all .venv/.compiled
	CAMPAIGN=10 $(PYTEST) -m 'slow or gl or browser or not slow'

lint: checks
	$(BIN)/ruff format --check

bench: $(INSTALLED)
	$(BIN)/landing-eval benchmark

docs: .venv/.installed-docs build/demo/replay.html build/demo/report/report.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Pages of the site that are answers of commands.
build/demo/replay.html: | .venv/.installed-docs
	mkdir -p $(@D)
	$(BIN)/landing-eval replay landing --out $@

build/demo/report/report.html: | .venv/.installed-docs
	rm -rf $(@D) build/demo/flights
	$(BIN)/landing-eval gap-example --out build/demo/flights
	$(BIN)/landing-eval gap build/demo/flights/fit/*.csv --heldout build/demo/flights/heldout/*.csv --out $(@D)

# What is pinned stays as long as it goes together; `rm constraints.txt` before, and all is the newest. A line with a
# condition is for some Pythons or systems only. pip reads the file as it is.
lock: .venv/.installed-test
	$(BIN)/uv pip compile -q --universal --python-version $(OLDEST) --all-extras --no-annotate \
	  --custom-compile-command 'make lock' -o constraints.txt pyproject.toml

# Zig's C++ compiler, from the package index, links against the oldest C library that MuJoCo's own wheel runs
# with: so one wheel serves all Linuxes that MuJoCo serves, wherever it is built. libmujoco is MuJoCo's.
wheel: .venv/.installed-wheel
	rm -rf dist build/wheel
	CXX="$(CURDIR)/$(BIN)/python -m ziglang c++ -target $(MACHINE)-linux-gnu.$(GLIBC)" \
	  $(BIN)/python -m build --outdir build/wheel
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/auditwheel repair --exclude 'libmujoco.so.*' \
	  --only-plat --plat manylinux_$(subst .,_,$(GLIBC))_$(MACHINE) --wheel-dir dist build/wheel/*.whl
	mv build/wheel/*.tar.gz dist

release: wheel
	$(BIN)/python .ci/release.py

# A group of dependencies, on top of what is there.
.venv/.installed-%: $(SOURCES) | .venv/.torch
	$(PIP) -e '.[$*]'
	@touch $@

# Compiled functions that most tests call: once, before the workers of the tests start and each of them would do it.
.venv/.compiled: tests/compile.py $(wildcard models/*.py models/plants/*.py) | .venv/.installed-test
	$(BIN)/python -m tests.compile >/dev/null
	@touch $@

# PyTorch alone, first: training here uses the processor only, and the CPU build is a tenth of the default one.
.venv/.torch: | .venv/.created
	@$(BIN)/python -c 'import torch' 2>/dev/null || test '$(TORCH)' != cpu || \
	  $(PIP) --no-deps --retries 1 --index-url $(CPU_BUILDS) torch 2>.venv/torch.log || \
	  echo "note: $(CPU_BUILDS) has no PyTorch for this machine, or is not reached from here (.venv/torch.log). What follows" \
	       "takes your package index's build, on Linux some 3 GB with CUDA. To avoid that, stop (Ctrl-C)," \
	       "install a build without CUDA with $(BIN)/pip, and go on."
	@touch $@

.venv/.created:
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
	@touch $@
