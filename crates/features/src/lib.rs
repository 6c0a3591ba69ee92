//! No code: the manifest switches on the features of dependencies that tests need, so that a test build adds tests alone.
