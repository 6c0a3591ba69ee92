# Common commands; `just` lists them. CONTRIBUTING.md describes $RELUME_TEST_DATA.

default:
    @just --list

# Type-check everything; reuses the build scripts and macros of the release build
check:
    cargo check --release --workspace --all-targets

# Tests that need neither a GPU nor test data; arguments filter by name
test *FILTER:
    cargo test --release {{FILTER}}

# All tests, including those that need a GPU or the test data
test-all *FILTER:
    cargo test --release {{FILTER}} -- --include-ignored

# Check formatting, lints and API documentation; warnings are errors
lint:
    cargo fmt --check
    cargo clippy --release --workspace --all-targets -- -D warnings
    RUSTDOCFLAGS='-D warnings' cargo doc --release --no-deps --workspace

# Check spelling, and licences and sources of dependencies (pip install typos)
audit:
    typos
    .ci/dependencies

# Benchmark each stage of the CPU engine, milliseconds
bench:
    cargo bench -p relume-bench --bench engine

# Run the demo: train on a synthetic scene, relight, measure; writes demo-out/
demo:
    cargo run --release -- demo

# Build the documentation site; writes target/site/site
site:
    .ci/site target/site

# Run the HTTP service on 127.0.0.1:7878
serve *ARGS:
    cargo run --release -- serve {{ARGS}}

# Write openapi/openapi.json from the handlers
openapi:
    cargo run --release -- openapi > openapi/openapi.json

# Run all checks that a change must pass
ci:
    .ci/run

# Measure the accuracy tables at this commit: captures of CONTRIBUTING.md and of benches/lights.py, and a folder for reports, tables and their page
results DATA LIGHTS WORK *ARGS:
    cargo build --release --bin relume
    python3 benches/accuracy/measure.py {{DATA}} {{LIGHTS}} {{WORK}} {{ARGS}}

# Measure build times of this commit and of others, seconds
build-times *COMMITS:
    benches/build_times {{COMMITS}}
