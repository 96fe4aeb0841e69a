# make run   build and start the service on 127.0.0.1:8080 with the example cohort
# make test  everything that CI runs; installs what the tests need when it is missing
# make bench the benchmarks behind the figures of docs/benchmarks.md

.PHONY: run test bench tools

run:
	cargo run --release --locked -- serve

test: tools
	cargo fmt --all --check
	cargo clippy --locked --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps --document-private-items --quiet
	cargo test --locked --doc
	cargo test --locked --lib --test suite

bench:
	cargo bench --locked

# A C compiler builds SQLite, curl runs the commands of the README, rustfmt and clippy check the code.
tools:
	@command -v cc >/dev/null || { apt-get update -qq && apt-get install -y -qq gcc libc6-dev; }
	@command -v curl >/dev/null || { apt-get update -qq && apt-get install -y -qq curl; }
	@cargo fmt --version >/dev/null 2>&1 || rustup component add rustfmt
	@cargo clippy --version >/dev/null 2>&1 || rustup component add clippy
