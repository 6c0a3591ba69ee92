//! Report of the validation of a capture.

use serde::{Deserialize, Serialize};

/// Report of the validation of a capture.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CaptureReport {
    /// Recognised layout, e.g. `nerf-synthetic`, `nerfstudio`, `colmap`, `llff`.
    pub layout: String,
    /// Number of training photographs.
    pub train_images: usize,
    /// Number of held-out photographs.
    pub test_images: usize,
    /// Width of the first training photograph, pixels.
    pub width: u32,
    /// Height of the first training photograph, pixels.
    pub height: u32,
    /// Number of sparse points.
    pub points: usize,
    /// True if the alpha channel is a mask.
    pub has_alpha: bool,
    /// True if at least one held-out view has ground truth in addition to its photograph.
    pub has_ground_truth: bool,
    /// Names of lights with an environment map in the capture.
    pub lights: Vec<String>,
    /// Centre of the region of interest, capture units.
    pub centre: [f64; 3],
    /// Radius of the region of interest, capture units.
    pub radius: f64,
    /// Warnings of the import, e.g. the names of missing images.
    pub warnings: Vec<String>,
    /// Quality problems of photographs, e.g. blur, darkness or little overlap, and facts about the import, e.g. the evidence for
    /// the up direction. Empty for captures that were stored by a version without these checks.
    #[serde(default)]
    pub notes: Vec<PhotographNote>,
}

impl CaptureReport {
    /// The notes about one photograph, and the warnings that name it.
    pub fn about(&self, photograph: &str) -> Vec<String> {
        let noted = self.notes.iter().filter(|note| note.photographs.iter().any(|name| name == photograph));
        let named = self.warnings.iter().filter(|warning| names(warning, photograph));
        noted.map(|note| &note.text).chain(named).cloned().collect()
    }
}

/// True if a text contains the name of a file, not as a part of a longer name.
fn names(text: &str, file: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || matches!(c, '/' | '_' | '-' | '.');
    text.match_indices(file).any(|(at, _)| {
        let before = text[..at].chars().next_back();
        let mut after = text[at + file.len()..].chars();
        let ends = match after.next() {
            // The full stop of a sentence.
            Some('.') => !after.next().is_some_and(char::is_alphanumeric),
            next => !next.is_some_and(is_part),
        };
        !before.is_some_and(is_part) && ends
    })
}

/// What a note asks of its reader.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NoteKind {
    /// A quality problem with its remedy.
    #[default]
    Hint,
    /// A fact about the import. It needs no action.
    Fact,
}

/// A quality problem of photographs, or a fact about the import.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PhotographNote {
    /// The problem and its remedy, or the fact.
    pub text: String,
    /// Whether the text is a hint or a fact; `hint` for captures that were stored by a version without kinds.
    #[serde(default)]
    pub kind: NoteKind,
    /// Names of the affected photographs; empty if the text concerns the whole capture.
    pub photographs: Vec<String>,
}
