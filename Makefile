# make help      this list
# make run       build and start the service on 127.0.0.1:8080 with the example cohort
# make check     before every commit: format, lints and unit tests of the libraries, and of scripts where their tools are
# make test      before every pull request: format, lints, unit tests, the suite on SQLite, doc tests, examples
# make test-others  all that takes other programs: PostgreSQL, Python, Node, a browser; as root installs what is missing
# make test-all  both
# make tools     installs a C and a C++ compiler, curl, rustfmt and clippy where they are missing; as root
# make spell     spelling of all files
# make scripts   format and lints of scripts in Python and of the page, by ruff and Biome; FIX=1 mends what they can
# make dashboard       the page for browsers, from dashboard/src to dashboard/dist
# make dashboard-test  the page in Chromium on a debug build; makes the pictures of docs/screens
# make site    the documentation for browsers, in target/site/html, with navigation and a search; without a network once its tools are there
# make contract  the OpenAPI document against the running service for six minutes, as `make test-all` does outside CI
# make attack    the known attack requests in full size, then an hour of search for new ones
# make fuzz      every fuzz target for ten minutes
# make sbom      the components of the program, as CycloneDX, in target/sbom.cdx.json
# make test-engine     crates/shapelex-engine, a workspace of its own, whose packages are built once for all checkouts
# make bench     one table beside peers and limits of the machine, losses first, then instructions of the kernels beside the
#                committed counts; DATA=folder of contours, ARGUMENTS="--write docs" also makes docs/performance.md
# make weight  cost of a cold build by crate, size, memory at rest, packages; ARGUMENTS="--before COMMIT" beside another commit
# make dist    the program as it is packaged, in target/dist: optimised across crates, which takes longer to build; then in target/packages
#              a wheel, a package for Debian, licences, SBOM, checksums, and with SIGNING_KEY a signature
# make criterion the benchmarks behind the figures of docs/benchmarks.md

.PHONY: run help check test test-others test-all test-engine test-engine-if-built built spell scripts dashboard dashboard-test site contract attack fuzz sbom bench weight dist criterion needs needs-all tools

CODESPELL = 2.4.3
RUFF = 0.17.6
# Features of the build that all tests share.
FEATURES = --features shapelex-server/schema
export FEATURES
TARGET = $(or $(CARGO_TARGET_DIR),target)

run:
	@tests/needs.sh cargo cc make
	cargo run --release --locked -- serve

# Prints the first comment block of this file.
help:
	@sed -n '/^#/!q;s/^# //p' $(firstword $(MAKEFILE_LIST))

check:
	cargo fmt --all --check
	cargo clippy --locked $(FEATURES) --lib -- -D warnings
	cargo test --locked $(FEATURES) --lib
	@if test -x target/scripts/bin/ruff || test -x dashboard/node_modules/.bin/biome; then $(MAKE) --no-print-directory scripts; fi

# What a newcomer runs: Rust, a C compiler, make and curl are enough. One build, in one shape, serves all of it.
test: needs
	@tests/steps.sh test

# What takes a C++ compiler, Python, Node, a browser or PostgreSQL, in two lanes. Where one of them is missing, and root cannot install it,
# its step is skipped with a reason. BEGAN is when CI began: what takes long is left out when its time may end.
test-others: needs-all
	@BEGAN=$(BEGAN) tests/steps.sh others

test-all:
	@$(MAKE) test-others
	@$(MAKE) test

# The pinned version in target/spell, else the one of the machine. `.codespellrc` lists exceptions.
spell:
	@if target/spell/bin/codespell --version 2>/dev/null | grep -qx '$(CODESPELL)' \
	|| { command -v python3 >/dev/null && python3 tests/environment.py target/spell codespell==$(CODESPELL); }; \
	then target/spell/bin/codespell; \
	elif command -v codespell >/dev/null; then codespell; \
	else echo "SKIPPED: the spell check, there is no codespell, and no python3 that can install it"; fi

# The pinned ruff in target/scripts; Biome as the lock of the page says.
scripts:
	@if target/scripts/bin/ruff --version 2>/dev/null | grep -qx 'ruff $(RUFF)' \
	|| { command -v python3 >/dev/null && python3 tests/environment.py target/scripts ruff==$(RUFF); }; \
	then target/scripts/bin/ruff check $(if $(FIX),--fix) . && target/scripts/bin/ruff format $(if $(FIX),,--check) .; \
	else echo "SKIPPED: the lints of Python, there is no ruff, and no python3 that can install it"; fi
	@dashboard/run.sh $(if $(FIX),tidy,lint)
	@clients/typescript/run.sh $(if $(FIX),tidy,lint)

dashboard:
	dashboard/run.sh build

# The program in target/debug, in the shape of the tests.
built:
	cargo test --locked $(FEATURES) --test suite --no-run

dashboard-test: built
	SCREENS=docs/screens dashboard/run.sh test

site:
	python3 docs/site.py

contract: built
	python3 tests/contract/run.py long

attack:
	cargo build --release --locked
	python3 tests/attack/run.py full --binary target/release/shapelex
	python3 benches/attack/run.py --binary target/release/shapelex --minutes 60 --report target/attack.json

# No sanitizer: the project has no unsafe code. Each target writes its findings to fuzz/artifacts.
fuzz:
	@cargo fuzz --version >/dev/null 2>&1 || cargo install --locked cargo-fuzz@0.13.2
	for target in $$(cargo fuzz list); do fuzz/run.sh $$target 600 || exit 1; done

# Its dependencies take longer to build than all others, so they are kept outside of the checkout, and `make test-all` runs this only
# where they are built already. Python reads the parts and serves a bucket; the service computes the same means and dictionaries.
ENGINE_TARGET = $(or $(CARGO_TARGET_DIR),$(or $(XDG_CACHE_HOME),$(HOME)/.cache)/shapelex/engine)
ENGINE = --locked --manifest-path crates/shapelex-engine/Cargo.toml --target-dir $(ENGINE_TARGET)
ENGINE_READY = $(ENGINE_TARGET)/ready-$(shell cat crates/shapelex-engine/Cargo.lock | cksum | cut -d ' ' -f 1)
ENGINE_PYTHON = $(ENGINE_TARGET)/python/bin/python
test-engine: tools
	cargo fmt --manifest-path crates/shapelex-engine/Cargo.toml --check
	cargo clippy $(ENGINE) --lib --bins -- -D warnings
	cargo clippy $(ENGINE) --all-features --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc $(ENGINE) --all-features --no-deps --document-private-items --quiet
	@command -v python3 >/dev/null && { test -x $(ENGINE_PYTHON) || python3 tests/environment.py $(ENGINE_TARGET)/python; } \
	&& $(ENGINE_PYTHON) -m pip install --quiet --requirement crates/shapelex-engine/tests/requirements.txt \
	|| { rm -rf $(ENGINE_TARGET)/python; echo "SKIPPED: pandas and DuckDB read no parts, they cannot be installed"; }
	if test -x $(ENGINE_PYTHON); then export SHAPELEX_ENGINE_PYTHON="$(ENGINE_PYTHON)"; fi; cargo test $(ENGINE) --all-features
	cargo build $(ENGINE) --all-features
	$(MAKE) built
	@if command -v python3 >/dev/null; then python3 crates/shapelex-engine/tests/service.py \
	$(TARGET)/debug/shapelex $(ENGINE_TARGET)/debug/shapelex-engine; \
	else echo "SKIPPED: the service and the engine are not compared, there is no python3"; fi
	@touch $(ENGINE_READY)

# BEGAN is when CI began: what takes long is left out when its time may end.
test-engine-if-built:
	@if ! test -e $(ENGINE_READY); then \
	echo "SKIPPED: crates/shapelex-engine, whose dependencies are not built here; make test-engine builds them once"; \
	elif test -n "$(BEGAN)" && test "$$(( $$(date +%s) - $(or $(BEGAN),0) ))" -gt 3000; then \
	echo "SKIPPED: crates/shapelex-engine, more than 50 minutes have passed"; \
	else $(MAKE) test-engine; fi

sbom:
	mkdir -p target
	cargo metadata --locked --format-version 1 --filter-platform "$$(rustc -vV | sed -n 's/^host: //p')" > target/metadata.json
	python3 deploy/sbom.py target/metadata.json --lock Cargo.lock --page-lock dashboard/package-lock.json --out target/sbom.cdx.json

# The pinned peers in target/peers. Counts of instructions need valgrind, and say so without it.
bench:
	@test -x target/peers/bin/python || python3 tests/environment.py target/peers
	@target/peers/bin/python -m pip install --quiet --requirement benches/peers/requirements.txt
	target/peers/bin/python benches/peers/run.py $(if $(DATA),--data $(DATA)) $(ARGUMENTS)
	python3 benches/instructions/run.py

weight:
	python3 benches/weight/run.py $(ARGUMENTS)

dist:
	cargo build --profile dist --locked
	deploy/package.sh $(TARGET)/dist/shapelex $(TARGET)/packages

criterion:
	cargo bench --locked

# Names what is missing, and installs nothing.
needs:
	@tests/needs.sh cargo rustfmt clippy cc make curl

needs-all:
	@tests/needs.sh cargo rustfmt clippy cc c++ make curl

tools:
	@tests/needs.sh --install
