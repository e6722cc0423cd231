# Every target makes the virtual environment that it needs. Outside this folder there are only the
# cache of compiled kernels, in the user's cache directory, and Debian packages that the tests need,
# which `make test` installs where it runs as root.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEBIAN_PACKAGES := gcc libc6-dev clang python3-venv \
  cppcheck gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm gcc-avr avr-libc simavr \
  binutils cmake iverilog verilator yosys graphviz nodejs chromium fonts-dejavu-core

.PHONY: help demo test test-portable check bench docs figures page strip debian clean

help:
	@echo "make demo     synthesise the paper's two-symbol pendulum policy and draw it"
	@echo "make test     install what the tests need and run them all"
	@echo "make test-portable  the same where POSIX is hidden, by zig's compiler; TESTS=\"tests/cli\": some"
	@echo "make check    formatting, lint, types"
	@echo "make bench    measure (ONLY="solve told": some of it), and write benchmarks/README.md and results.json"
	@echo "make docs     draw the figures and build the site in build/docs; a warning is an error"
	@echo "make figures  draw the figures of README and guides again"
	@echo "make page     bundle the explorer's page again from its modules (Node)"
	@echo "make strip    take outputs out of the notebooks"
	@echo "make clean    remove what the other targets made"

$(VENV)/installed: pyproject.toml
	@echo "installing capsyn into $(VENV) ..."
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/developed: pyproject.toml
	@echo "installing capsyn and its tools into $(VENV) ..."
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@ $(VENV)/installed

demo: $(VENV)/installed
	@mkdir -p build/demo
	$(BIN)/capsyn synth cart-pendulum -o build/demo/cart-pendulum.cap
	$(BIN)/capsyn plot build/demo/cart-pendulum.cap -o build/demo/cart-pendulum.png

test: debian
	@$(MAKE) --no-print-directory $(VENV)/developed
	@$(MAKE) --no-print-directory node_modules/.package-lock.json || \
	  echo "could not install MicroPython and what bundles the page; tests that need them are skipped"
	@$(BIN)/python -m compileall -q src  # once, not in each process that tests start
	$(BIN)/python -m pytest -n auto --dist worksteal

test-portable: $(VENV)/developed
	PYTHONPATH=tests/support/portable CC="$(CURDIR)/$(BIN)/python -m ziglang cc" \
	  $(BIN)/python -m pytest -n auto --dist worksteal $(TESTS)

check: $(VENV)/developed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(VENV)/developed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python benchmarks/run.py $(ONLY)

page: node_modules/.package-lock.json
	npm run --silent page
	npm run --silent page-memory

node_modules/.package-lock.json: package.json package-lock.json
	@echo "installing MicroPython and what bundles the page into node_modules ..."
	npm ci --loglevel=error --no-audit --no-fund
	@touch $@

docs: $(VENV)/developed figures
	$(BIN)/sphinx-build -W --keep-going -q -E -b html docs build/docs

figures: $(VENV)/developed
	$(BIN)/python docs/figures/draw.py

strip:
	$(PYTHON) docs/notebooks/strip.py

debian:
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  missing=$$(for p in $(DEBIAN_PACKAGES); do dpkg -s $$p >/dev/null 2>&1 || echo $$p; done; \
	    command -v npm >/dev/null || echo npm); \
	  if [ -n "$$missing" ]; then \
	    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
	      apt-get install -qq --no-install-recommends $$missing >/dev/null; } || \
	      echo "could not install $$missing; tests that need them are skipped by name"; \
	  fi; \
	fi

clean:
	rm -rf $(VENV) node_modules build dist .pytest_cache .ruff_cache .mypy_cache .hypothesis
