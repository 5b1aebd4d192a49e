# The few verbs a developer needs. `make demo` and `make test` need only Rust, Python 3.11 and make.

PYTHON ?= python3
VENV ?= .venv
BIN := $(abspath $(VENV))/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
SHELL := /bin/bash
WHEELS := target/wheels

.PHONY: docs/report.png demo test lint test-rust test-python develop bench fuzz examples pictures wheel clean help

help:  ## List the verbs
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(PIP) --upgrade pip

demo: $(BIN)/python  ## Install, then score and draw the example: out/report.html, out/drawn/
	@echo "building the extension: about two minutes"
	$(BIN)/python -m pip install --disable-pip-version-check .
	@mkdir -p out
	$(BIN)/dronepose-eval examples/predictions.csv examples/gt.csv --mesh examples/quadrotor.obj \
	    --compare examples/predictions_baseline.csv --by distance --html out/report.html
	$(BIN)/dronepose render examples/quadrotor.obj examples/gt.csv --camera 252.7,252.7,160,120,320,240 \
	    --out out/drawn --limit 24 --save silhouette --contact-sheet --force
	$(BIN)/dronepose render examples/quadrotor.obj examples/gt.csv --camera 252.7,252.7,160,120,320,240 \
	    --out out/compared --limit 1 --save silhouette --compare --sigma 1 --force
	@echo "wrote out/report.html, out/drawn/contact_sheet.png and out/compared/compare/"

wheel: $(BIN)/python  ## Build the wheel and install it with the development tools
	$(PIP) "maturin>=1.9.4,<2"
	rm -rf $(WHEELS)
	$(BIN)/maturin build --release --quiet --interpreter $(BIN)/python --out $(WHEELS)
	$(PIP) --force-reinstall --no-deps $(WHEELS)/*.whl
	wheel=$$(echo $(WHEELS)/*.whl) && $(PIP) "$$wheel[dev]"

test: wheel chromium lint test-rust test-python  ## Install what is missing and pass all tests

lint: wheel  ## Formatting, clippy, ruff, mypy, stubs
	cargo fmt --check
	cargo clippy --workspace --all-targets --features python -- -D warnings
	$(MAKE) lint-native
	$(BIN)/ruff check . && $(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest dronepose._native
	@test "$$(cargo tree -i glam --depth 0 2>/dev/null | wc -l)" = 1 || { cargo tree -i glam; exit 1; }

.PHONY: lint-native
lint-native:  # Builds for one processor leave out what others look for at run time.
	@case "$$(uname -m)" in x86_64) for cpu in x86-64-v3 icelake-server; do \
	    RUSTFLAGS="-C target-cpu=$$cpu -D warnings" \
	    cargo check --quiet --package dronepose-raster --lib --target-dir target/$$cpu || exit 1; done;; esac

test-rust:  ## Unit tests, property tests, command-line transcripts
	cargo test --workspace

.PHONY: miri
miri:  ## Unsafe code under Miri: `rustup toolchain install nightly --component miri rust-src`
	PROPTEST_CASES=16 MIRIFLAGS=-Zmiri-disable-isolation cargo +nightly miri test \
	    --package dronepose-raster --lib --target-dir target/miri -- raster::background

test-python: wheel  ## Tests of the installed wheel
	cd tests && $(BIN)/python -m pytest -c ../pyproject.toml --rootdir .. .

.PHONY: chromium
chromium:  # The HTML report is opened in a real browser; without root its test is skipped.
	@command -v chromium >/dev/null || { [ "$$(id -u)" = 0 ] && apt-get -qq update && \
	    DEBIAN_FRONTEND=noninteractive apt-get -qq install -y chromium >/dev/null; } || \
	    echo "chromium is not here and cannot be installed: the report's browser test will be skipped"

develop: $(BIN)/python  ## Editable install for work on the sources
	$(PIP) "maturin>=1.9.4,<2"
	source $(BIN)/activate && maturin develop --release --extras dev

bench: develop  ## Benchmarks in Rust, and against what else is installed
	cargo bench
	$(BIN)/python benches/bench_metrics.py
	$(BIN)/python benches/bench_render.py

fuzz:  ## Every parser for a minute (needs the nightly toolchain and cargo-fuzz)
	command -v cargo-fuzz >/dev/null || cargo install cargo-fuzz
	cd crates/raster && for target in $$(cargo fuzz list); do \
	    echo "== $$target"; mkdir -p fuzz/found/$$target; \
	    cargo +nightly fuzz run $$target fuzz/found/$$target fuzz/corpus/$$target -- \
	        -max_total_time=$${SECONDS_EACH:-60} -timeout=10 -rss_limit_mb=2048 || exit 1; done

examples: $(BIN)/python  ## Generate the example data again
	$(PIP) numpy
	$(BIN)/python examples/make_examples.py

docs/report.png: demo chromium  ## The README's picture, from the example data
	$(BIN)/dronepose-eval examples/predictions.csv examples/gt.csv --mesh examples/quadrotor.obj --html out/picture.html --quiet
	chromium --headless --no-sandbox --disable-gpu --hide-scrollbars --window-size=1280,1545 --screenshot=$@ file://$(CURDIR)/out/picture.html

pictures: develop  ## The pictures of docs/rendering.md
	$(BIN)/python docs/make_pictures.py

clean:  ## Remove what was built
	cargo clean
	rm -rf $(VENV) out
