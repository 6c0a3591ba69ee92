# Common commands; `just` lists them. CONTRIBUTING.md describes $RELUME_TEST_DATA.

default:
    @just --list

# Type-check everything; shares work with the release build
check:
    cargo check --release --workspace --all-targets

# Tests that need nothing but this machine; arguments filter by name
test *FILTER:
    cargo test --release {{FILTER}}

# All tests, including those of the GPU engine and of outside data
test-all *FILTER:
    cargo test --release {{FILTER}} -- --include-ignored

# Formatting, lints and API documentation without warnings
lint:
    cargo fmt --check
    cargo clippy --release --workspace --all-targets -- -D warnings
    RUSTDOCFLAGS='-D warnings' cargo doc --release --no-deps --workspace

# Spelling, licences and sources of dependencies (pip install typos)
audit:
    typos
    .ci/dependencies

# Milliseconds of each stage of the CPU engine
bench:
    cargo bench -p relume-bench --bench engine

# The demo: train on a synthetic scene, relight, measure; writes demo-out/
demo:
    cargo run --release -- demo

# The HTTP service on 127.0.0.1:7878
serve *ARGS:
    cargo run --release -- serve {{ARGS}}

# Write openapi/openapi.json from the handlers
openapi:
    cargo run --release -- openapi > openapi/openapi.json

# What a change must pass
ci:
    .ci/run

# Seconds of builds and edits, here and at other commits
build-times *COMMITS:
    benches/build_times {{COMMITS}}
