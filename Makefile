# The whole developer interface. `make help` prints it.
.DEFAULT_GOAL := help
SHELL := /bin/bash

# uv from the machine, else one of our own; an sdist or a bare Debian needs nothing but Python, cargo, node and npm.
UV ?= $(shell command -v uv || echo .uv/bin/uv)
PY := .venv/bin/python
STAMP := .venv/.carina-installed
RUN_STAMP := .venv/.carina-run
WEB_TOOLS := web/node_modules/.carina-tools
WEB_LIBRARIES := web/node_modules/.carina-build
RUST_SOURCES := $(shell find crates build_backend -name '*.rs' -o -name 'Cargo.toml' -o -name '*.py' 2>/dev/null) Cargo.toml Cargo.lock
WEB_SOURCES := $(shell find web -path web/node_modules -prune -o -type f -print 2>/dev/null)
CASE ?= phantom

# Python keeps what it compiled. Where a machine forbids it, each of the processes that a test run starts compiles its
# libraries anew: 10 s of the processor for pytest alone.
unexport PYTHONDONTWRITEBYTECODE

# No tool chain is downloaded without a question (tools/check_build_tools.sh): maturin would fetch Rust, uv a Python.
# Rust that a person agreed to is in .rust.
export MATURIN_NO_INSTALL_RUST := 1
export UV_PYTHON_DOWNLOADS := never
export PATH := $(PATH):$(CURDIR)/.rust/bin

.PHONY: help run build setup setup-tests test test-rust test-web test-python test-gpu soak fuzz check check-rust check-python check-web fmt docs bench bench-setup golden lock wheel wheels bundle test-wheels clean

help: ## print this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sort | awk -F ':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

.PHONY: build-tools
build-tools:
	@tools/check_build_tools.sh $(STAMP) $(RUN_STAMP)

.uv/bin/uv: | build-tools
	python3 -m venv .uv
	.uv/bin/pip install -q --disable-pip-version-check uv

# uv would install into the environment that is active, which may be another project's: each call names ours. (Not by
# VIRTUAL_ENV for all of make: pyo3's build would ask that environment's Python, in CI before there is one.)
# Locked, hashed dependencies first, then Carina itself (compiled, web UI built) in place.
# The web's libraries before them, so that nobody installs those at the same time.
$(STAMP): requirements.lock pyproject.toml $(RUST_SOURCES) $(WEB_SOURCES) | build-tools $(WEB_TOOLS) $(if $(findstring .uv/,$(UV)),.uv/bin/uv)
	@test -x $(PY) || $(UV) venv -q .venv
	$(UV) pip sync -q --python $(PY) --require-hashes requirements.lock
	@$(PY) tools/install_package.py $(UV) $(PY)
	@touch $@

# What runs, without tools for tests and lints. `install` and not `sync`: optional packages that a person added stay.
$(RUN_STAMP): requirements-run.lock pyproject.toml $(RUST_SOURCES) $(WEB_SOURCES) | build-tools $(WEB_LIBRARIES) $(if $(findstring .uv/,$(UV)),.uv/bin/uv)
	@test -x $(PY) || $(UV) venv -q .venv
	$(UV) pip install -q --python $(PY) --require-hashes -r requirements-run.lock
	@$(PY) tools/install_package.py $(UV) $(PY)
	@touch $@

# A folder that `make setup` has made complete stays so.
BUILT := $(if $(wildcard $(STAMP)),$(STAMP),$(RUN_STAMP))

build: $(BUILT) ## install, compile and build what runs, without tools for tests and lints

setup: $(STAMP) ## install, compile and build everything that development needs

run: $(BUILT) ## build what is missing and open the demo (CASE=patient for the real one)
	.venv/bin/carina demo $(CASE)

test: test-rust test-web test-python ## every test that needs no special hardware

# The bindings have no tests of their own, and nothing of them is built. But with them, as they are in the module, the crates
# below have the dependencies that the module's have: without, each was optimised twice, once for the module and once here.
ALL_CRATES := --profile checked --workspace --features carina-bindings/extension-module

# The same random cases every time, as in Python (tests/conftest.py): a test that turns red tells of the change at hand.
# `make soak` draws new ones.
test-rust: export PROPTEST_RNG_SEED ?= 1
test-rust:
	cargo test $(ALL_CRATES)

$(WEB_TOOLS): web/package-lock.json | build-tools
	cd web && npm ci --no-audit --no-fund
	@touch $(WEB_TOOLS) $(WEB_LIBRARIES)

$(WEB_LIBRARIES): web/package-lock.json | build-tools
	cd web && npm ci --omit=dev --no-audit --no-fund
	@touch $@

test-web: $(WEB_TOOLS)
	cd web && npm test

# Ray is an extra of 76 MB: only who tests downloads it. Elsewhere than on Linux there is nothing in it.
CLUSTER_STAMP := .venv/.carina-cluster
$(CLUSTER_STAMP): requirements-cluster.lock $(STAMP)
	$(UV) pip install -q --python $(PY) --require-hashes -r requirements-cluster.lock
	@touch $@

# Force feedback is a separate package: only tests, checks and documentation need its compiled module.
HAPTICS_STAMP := .venv/.carina-haptics
HAPTICS_SOURCES := $(shell find packages/carina-haptics -name '*.rs' -o -name 'Cargo.toml' 2>/dev/null) packages/carina-haptics/pyproject.toml
$(HAPTICS_STAMP): $(HAPTICS_SOURCES) $(STAMP)
	$(UV) pip install -q --python $(PY) --no-deps --reinstall-package carina-haptics -e packages/carina-haptics
	@touch $@

# A worker is a process with servers and a browser of its own, and often waits for them: one more than there are cores.
# Beyond four they wait for memory.
WORKERS ?= $(shell $(PY) -c 'import os; print(min((os.cpu_count() or 1) + 1, 4))' 2>/dev/null || echo 3)

setup-tests: $(STAMP) $(CLUSTER_STAMP) $(HAPTICS_STAMP)

test-python: $(STAMP) $(CLUSTER_STAMP) $(HAPTICS_STAMP)
	$(PY) tools/find_browser.py --install
	@# In a new clone the tests are compiled once, and not by each worker at the same time.
	@test -d tests/plan/__pycache__ || $(PY) -m pytest --collect-only -qq >/dev/null || true
	$(PY) -m pytest -m "not soak" -n $(WORKERS) --dist loadscope --no-loadscope-reorder -ra --durations=25

# Not part of `make test`: wgpu is a large build, and most machines that test have no adapter. Here a missing one is a
# failure, and the software one of Mesa (lavapipe) is enough. The Python tests take the wheel, as people get it.
test-gpu: $(STAMP) ## the GPU caster and the wheel, on a software adapter where there is no other
	$(PY) tools/find_adapter.py --install
	cargo clippy --release -p carina-gpu --features wgpu --all-targets -- -D warnings
	cargo clippy --release -p carina-bindings --features gpu -- -D warnings
	CARINA_GPU_REQUIRED=1 cargo test --release -p carina-gpu --features wgpu -- --nocapture
	rm -rf target/gpu-wheel
	$(UV) build -q --wheel -o target/gpu-wheel
	test -x .venv-gpu/bin/python || $(UV) venv -q .venv-gpu
	$(UV) pip sync -q --python .venv-gpu/bin/python --require-hashes requirements.lock
	$(UV) pip install -q --python .venv-gpu/bin/python --no-deps target/gpu-wheel/*.whl
	CARINA_GPU_REQUIRED=1 .venv-gpu/bin/python -m pytest -m gpu -ra tests

# JupyterLab has a separate environment, because only one test of `make soak` needs its hundred packages.
NOTEBOOK_STAMP := .venv-notebook/.carina-notebook
$(NOTEBOOK_STAMP):
	test -x .venv-notebook/bin/python || $(UV) venv -q .venv-notebook
	$(UV) pip install -q --python .venv-notebook/bin/python "jupyterlab>=4" "anywidget>=0.9"
	@touch $@

soak: $(STAMP) $(CLUSTER_STAMP) $(HAPTICS_STAMP) $(NOTEBOOK_STAMP) ## what runs for minutes: 20,000 poses against the f64 ray caster, 10,000 sequences of edits, 2,000 drives of the scope, a cluster that loses members
	PROPTEST_CASES=2000 cargo test --profile checked -p carina-airpath --lib section
	cargo test $(ALL_CRATES) -- --include-ignored
	cargo clippy --profile checked -p carina-bindings -p carina-gpu --features carina-bindings/gpu,carina-gpu/wgpu -- -D warnings
	CARINA_JUPYTER=.venv-notebook/bin/jupyter $(PY) -m pytest -m soak -ra -o faulthandler_timeout=0

# atheris has a separate environment, because only the fuzzer needs it. The generated inputs need the packages of the tests.
FUZZ_STAMP := .venv-fuzz/.carina-fuzz
FUZZ_SECONDS ?= 60
$(FUZZ_STAMP): $(STAMP)
	test -x .venv-fuzz/bin/python || $(UV) venv -q --python $(PY) .venv-fuzz
	$(UV) pip install -q --python .venv-fuzz/bin/python "atheris>=3.0"
	@touch $@

fuzz: $(FUZZ_STAMP) ## coverage-guided fuzzing of headers and archives, FUZZ_SECONDS (60) for each of three targets
	PYTHONPATH=python:$(wildcard .venv/lib/python*/site-packages) .venv-fuzz/bin/python tools/fuzz_import.py --seconds $(FUZZ_SECONDS)

check: check-rust check-python check-web docs ## formatting, lints, types, layers, kernels, lock file, spelling, licences, advisories, documentation

# One profile for all crates: a second one would compile every dependency again, and find nothing else. GPU support is
# in the wheel alone: linted here, since no other build would notice that it is broken.
# The GPU renderer is linted by `make soak` and `make test-gpu`: wgpu is a large build, and CI has no adapter.
check-rust:
	cargo fmt --all --check
	cargo clippy --profile checked --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings -A rustdoc::private_intra_doc_links" \
	    cargo doc --profile checked --workspace --no-deps --document-private-items

check-web: $(WEB_TOOLS)
	cd web && npm run check

check-python: $(STAMP) $(HAPTICS_STAMP)
	.venv/bin/ruff format --check .
	.venv/bin/ruff check .
	.venv/bin/mypy
	$(PY) -m mypy.stubtest carina._core carina_haptics._force --ignore-missing-stub
	.venv/bin/typos
	$(PY) tools/check_layers.py
	$(PY) tools/check_kernels.py
	$(PY) tools/check_repository.py
	$(PY) tools/check_wording.py
	$(PY) tools/audit.py
	$(PY) tools/lock_requirements.py --check --uv $(UV)

fmt: $(STAMP) $(WEB_TOOLS) ## format everything
	cargo fmt --all
	.venv/bin/ruff check -q --fix . || true
	.venv/bin/ruff format -q .
	cd web && npm run fmt

golden: $(STAMP) ## rewrite the golden images (look at them before you commit)
	CARINA_GOLDEN=rewrite $(PY) -m pytest -m "" -q tests -k golden

# A separate environment: the tools that write pages are not part of the tests or of the product.
DOCS_STAMP := .venv-docs/.carina-docs
$(DOCS_STAMP): requirements-docs.lock | $(STAMP)
	test -x .venv-docs/bin/python || $(UV) venv -q .venv-docs
	$(UV) pip sync -q --python .venv-docs/bin/python --require-hashes requirements-docs.lock
	@touch $@

docs: $(DOCS_STAMP) $(STAMP) $(HAPTICS_STAMP) ## the documentation and the Python reference as pages, in build/docs
	$(PY) tools/make_docs.py

bench-setup: $(STAMP)
	$(UV) pip install -q --python $(PY) "vtk>=9.4" "numba>=0.61" "scipy>=1.14" "dijkstra3d>=1.15" "scikit-image>=0.24"

bench: bench-setup ## figures beside VTK, numba, scipy and dijkstra3d; pictures and JSON in benchmarks/results (BENCH=--quick: minutes)
	.venv/bin/carina bench render $(BENCH) -o benchmarks/results
	.venv/bin/carina bench isoregion $(BENCH) -o benchmarks/results
	.venv/bin/carina bench track $(BENCH) -o benchmarks/results

lock: $(if $(findstring .uv/,$(UV)),.uv/bin/uv) ## export requirements*.lock from pyproject.toml
	$(if $(wildcard $(PY)),$(PY),python3) tools/lock_requirements.py --uv $(UV)

wheel: $(if $(findstring .uv/,$(UV)),.uv/bin/uv) ## a wheel for this machine with the web UI and GPU support inside, in dist/
	$(UV) build --wheel -o dist

# An environment with zig (300 MB) and maturin: nobody who develops or tests needs it.
WHEELS_STAMP := .venv-wheels/.carina-wheels
$(WHEELS_STAMP): requirements-wheels.lock | build-tools $(if $(findstring .uv/,$(UV)),.uv/bin/uv)
	test -x .venv-wheels/bin/python || $(UV) venv -q .venv-wheels
	$(UV) pip sync -q --python .venv-wheels/bin/python --require-hashes requirements-wheels.lock
	@touch $@

wheels: $(WHEELS_STAMP) ## the wheels to publish: Linux, glibc 2.17, x86-64 and 64-bit ARM, in dist/ (docs/releasing.md)
	.venv-wheels/bin/python tools/build_wheels.py $(PROCESSORS)

# PYTHON_TO_BUNDLE: a Python installation that runs from any place (python-build-standalone needs glibc 2.17 only).
bundle: $(WHEELS_STAMP) ## a folder with Carina and Python (tar.gz) and a container image (OCI) of it, in dist/ (docs/releasing.md)
	.venv-wheels/bin/python tools/build_bundle.py --uv $(UV) $(if $(PYTHON_TO_BUNDLE),--python $(PYTHON_TO_BUNDLE))
	.venv-wheels/bin/python tools/build_oci_image.py
	.venv-wheels/bin/python tools/release_documents.py sums

# The tests of the other processor need tools/unpack_arm64_python.sh once.
test-wheels: $(STAMP) ## install the wheels of dist/ in empty environments and start them (docs/releasing.md)
	CARINA_WHEELS_REQUIRED=1 $(PY) -m pytest -m soak -ra tests/installation

clean: ## remove what was built (not the caches of cases)
	rm -rf .venv .venv-docs .venv-gpu .venv-wheels target dist build web/node_modules python/carina/_web python/carina/_licences
	find python packages -name '*.so' -delete
