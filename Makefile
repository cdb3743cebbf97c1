# femdeform: `make demo` runs the first scene, `make test` the test suite; both set up what is missing first.
#
#   make setup    system packages (where apt and root or sudo are there), .venv, Python packages, petsc4py
#   make demo     set up, run scenes/rubber-mount.yaml, leave frames, a picture, plots and a report
#   make test     set up, static checks, the pages, all tests, those on two MPI ranks included
#   make gallery  the large scenes of the gallery, minutes each, against what they expect
#   make lint     set up, ruff, mypy --strict and the import contracts
#   make docs     set up, build the pages of docs/ into site/; a broken link or example of a page fails
#   make peers    a separate environment with the packages that the benchmarks compare with
#   make clean    remove environments and results

SHELL := /bin/bash
PYTHON ?= python3
VENV ?= .venv
PEERS ?= .venv-peers
BIN := $(VENV)/bin
DEMO := results/rubber-mount

# PETSc with MUMPS, hypre and PT-Scotch and an Open MPI; an optimised BLAS for MUMPS; what gmsh and vtk load at run time.
PACKAGES := libpetsc-real-dev libopenblas0-pthread pkg-config make g++ python3-venv \
            libgl1 libgl1-mesa-dri libglu1-mesa libegl1 libxrender1 libxcursor1 libxft2 libxinerama1 libxfixes3 libxi6

# Open MPI refuses to start as root unless told twice; containers often run as root.
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1

.PHONY: setup demo test lint docs peers clean

setup: $(VENV)/.ready

.PHONY: system
$(VENV)/.system:
	@mkdir -p $(VENV)
	@set -euo pipefail; \
	if pkg-config --exists PETSc 2>/dev/null && command -v mpiexec >/dev/null \
	   && dpkg -s $(PACKAGES) >/dev/null 2>&1; then \
	  echo "setup: system packages are there"; \
	elif ! command -v apt-get >/dev/null; then \
	  echo "setup: no apt-get here: install PETSc (with MUMPS) and MPI yourself to have the parallel solvers"; \
	elif [ "$$(id -u)" = 0 ]; then \
	  echo "setup: installing system packages"; \
	  export DEBIAN_FRONTEND=noninteractive; apt-get update -qq && apt-get install -y -qq --no-install-recommends $(PACKAGES) >/dev/null \
	    || echo "setup: apt-get failed; going on without what it would have installed"; \
	elif sudo -n true 2>/dev/null; then \
	  echo "setup: installing system packages with sudo"; \
	  sudo -n apt-get update -qq && sudo -n DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(PACKAGES) >/dev/null \
	    || echo "setup: apt-get failed; going on without what it would have installed"; \
	else \
	  echo "setup: not root and no sudo without a password: going on without installing system packages"; \
	fi
	@touch $@

$(VENV)/bin/python: $(VENV)/.system
	@echo "setup: making $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install -q --disable-pip-version-check 'setuptools<70' 'cython<3.1' wheel 'numpy>=2.0'
	@touch $@

# petsc4py is compiled against the PETSc that is installed, so its release has to match.
$(VENV)/.petsc: $(VENV)/bin/python
	@set -euo pipefail; \
	if pkg-config --exists PETSc 2>/dev/null; then \
	  version=$$(pkg-config --modversion PETSc); prefix=$$(pkg-config --variable=prefix PETSc); \
	  echo "setup: building petsc4py $$version (about three minutes)"; \
	  $(BIN)/python -m pip install -q --disable-pip-version-check 'mpi4py>=4.0' \
	    && PETSC_DIR=$$prefix $(BIN)/python -m pip install -q --disable-pip-version-check --no-build-isolation petsc4py==$$version \
	    || echo "setup: petsc4py $$version could not be built: femdeform will use SciPy's direct solver, on one rank"; \
	else \
	  echo "setup: no PETSc found: femdeform will use SciPy's direct solver, on one rank"; \
	fi
	@touch $@

$(VENV)/.ready: $(VENV)/.petsc pyproject.toml
	@echo "setup: installing Python packages"
	@$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[dev]'
	@touch $@
	@echo "setup: done"

demo: setup
	@if grep -qs '"status": "done"' $(DEMO)/result.json; then echo "demo: $(DEMO) is there already (make clean-demo to run it again)"; \
	 elif [ -e $(DEMO)/checkpoint.h5 ]; then $(BIN)/femdeform run scenes/rubber-mount.yaml --out $(DEMO) --trace --resume; \
	 else $(BIN)/femdeform run scenes/rubber-mount.yaml --out $(DEMO) --trace; fi
	@[ -e $(DEMO)/view.png ] || $(BIN)/femdeform view $(DEMO) --png $(DEMO)/view.png
	@[ -e $(DEMO)/report.html ] || $(BIN)/femdeform report $(DEMO) --plots
	@echo "demo: see $(DEMO)/report.html, view.png, plots/ and frames.pvd (ParaView)"

.PHONY: clean-demo
clean-demo:
	rm -rf $(DEMO)

test: lint docs
	$(BIN)/python -m pytest

# Scenes that take minutes each, at full size, against what they expect.
.PHONY: gallery
gallery: setup
	FEMDEFORM_GALLERY=1 $(BIN)/python -m pytest -m gallery --timeout 3600

lint: setup
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy docs/hooks.py
	$(BIN)/lint-imports

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "docs: see site/index.html"

$(PEERS)/.ready:
	@$(PYTHON) -m venv $(PEERS)
	@$(PEERS)/bin/python -m pip install -q --disable-pip-version-check 'felupe>=9.0' 'scikit-fem>=10.0' scipy numpy
	@$(PEERS)/bin/python -m pip install -q --disable-pip-version-check 'newton>=1.0' \
	  || echo "peers: no Newton (physics engine) for this machine: its column stays empty"
	@$(PEERS)/bin/python -m pip install -q --disable-pip-version-check pypbd \
	  || echo "peers: no pyPBD for this machine: its row stays empty"
	@$(PEERS)/bin/python -m pip install -q --disable-pip-version-check 'taichi>=1.7' \
	  || echo "peers: no Taichi for this machine: its rows stay empty"
	@touch $@

peers: $(PEERS)/.ready
	@echo "peers: $(PEERS) is ready"

clean:
	rm -rf $(VENV) $(PEERS) results site
