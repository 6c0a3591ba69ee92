//! The list of all settings of a training, for the command line and for the reference page.

use super::{GROUP_RANGE, LearningRateChanges, LossWeightChanges, ShadingChanges, declared, range_text};

/// A setting as a caller names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// Its name, with its group in front: `iterations`, `weights.l1`.
    pub path: String,
    /// The type of its value in Rust.
    pub kind: &'static str,
    /// Its effect, in one or a few sentences.
    pub documentation: String,
    /// The accepted range, if it is a number.
    pub range: Option<String>,
}

impl Setting {
    /// The group of the setting; `None` for a single setting.
    pub fn group(&self) -> Option<&str> {
        self.path.split_once('.').map(|(group, _)| group)
    }

    /// The flag of `relume train`: `--weights-l1`.
    pub fn flag(&self) -> String {
        self.path.replace(['.', '_'], "-")
    }
}

/// All settings: single ones in the order of their declaration, then the groups `shading`, `weights` and `rates`.
pub fn settings() -> Vec<Setting> {
    let mut all: Vec<Setting> = declared()
        .into_iter()
        .map(|(name, kind, text, range)| Setting {
            path: name.to_owned(),
            kind,
            documentation: text.trim().to_owned(),
            range,
        })
        .collect();
    for (group, fields, range) in [
        ("shading", ShadingChanges::declared(), None),
        ("weights", LossWeightChanges::declared(), Some(range_text(&GROUP_RANGE))),
        ("rates", LearningRateChanges::declared(), Some(range_text(&GROUP_RANGE))),
    ] {
        all.extend(fields.into_iter().map(|(name, kind, text)| Setting {
            path: format!("{group}.{name}"),
            kind,
            documentation: text.trim().to_owned(),
            range: range.clone(),
        }));
    }
    all
}
