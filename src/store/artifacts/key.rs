//! Keys of artifacts.

use std::path::{Component, Path};

use crate::store::staged_upload::INCOMING;
use crate::store::uploads::UPLOADS;

/// Whether the path of `key` is within the artifact folder.
pub(in crate::store) fn is_key(key: &str) -> bool {
    !key.is_empty() && Path::new(key).components().all(|part| matches!(part, Component::Normal(_)))
}

/// Whether an artifact is never sent to the object store: an upload that is incomplete or not yet a capture.
pub(in crate::store) fn is_never_uploaded(key: &str) -> bool {
    matches!(key.split('/').next(), None | Some("" | INCOMING | UPLOADS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incomplete_files_stay_local_and_results_do_not() {
        assert!(["uploads/x", "incoming/y", ""].into_iter().all(is_never_uploaded));
        let made = ["captures/00", "environments/00", "attempts/j/1/model.ply", "exports/e", "uploadsx/y"];
        assert!(!made.into_iter().any(is_never_uploaded));
    }
}
