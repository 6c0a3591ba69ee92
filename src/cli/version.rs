//! The version of the program, the commit of its sources and the features of its build.

/// The version, e.g. `0.1.0`.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");
/// The commit of the sources, if the build stated it in `RELUME_COMMIT`.
const COMMIT: Option<&str> = option_env!("RELUME_COMMIT");

/// The optional parts that the program has.
pub(super) fn features() -> String {
    let all =
        [("gpu", cfg!(feature = "gpu")), ("otlp", cfg!(feature = "otlp")), ("web", cfg!(feature = "web"))];
    let there: Vec<&str> = all.into_iter().filter_map(|(name, is_there)| is_there.then_some(name)).collect();
    if there.is_empty() { "none".to_owned() } else { there.join(" ") }
}

/// The commit of the sources.
pub(super) fn commit() -> &'static str {
    COMMIT.filter(|commit| !commit.is_empty()).unwrap_or("unknown (the build did not state RELUME_COMMIT)")
}

/// The text of `--version`: the version, then one property a line.
pub(super) fn long() -> String {
    format!(
        "{VERSION}\ncommit    {}\nfeatures  {}\ntarget    {} {}",
        commit(),
        features(),
        std::env::consts::OS,
        std::env::consts::ARCH
    )
}
