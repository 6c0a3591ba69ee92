//! Errors of captures: a message for people and a code for programs.

use crate::photo_finder::MIN_IMAGES;
use crate::text::shown;

/// An error that names the file at fault, and the field in it.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The file system failed.
    #[error("{file}: cannot be read: {source}")]
    Io {
        /// The file that was read.
        file: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The archive is truncated, corrupt or of an unknown kind.
    #[error("{file}: {reason}")]
    ArchiveDamaged {
        /// The archive, or the entry in it.
        file: String,
        /// The reason.
        reason: String,
    },
    /// An entry that is not safe: a path that leads out of the archive, a link, a device, a duplicate.
    #[error("{file}: refused: {reason}")]
    UnsafeEntry {
        /// The entry's name as the archive states it.
        file: String,
        /// The reason.
        reason: String,
    },
    /// A limit of [`super::ImportLimits`] was exceeded.
    #[error("{file}: over the limit {limit}: {reason}")]
    OverLimit {
        /// The archive, entry or image.
        file: String,
        /// The field of [`super::ImportLimits`] that was exceeded.
        limit: &'static str,
        /// By how much.
        reason: String,
    },
    /// No importer recognises the files, or there are none.
    #[error("{}", unknown_layout(.reason, *.has_photographs))]
    UnknownLayout {
        /// A sentence with the name of the capture and the files that were found instead.
        reason: String,
        /// True if there are photographs, so that only their poses are missing.
        has_photographs: bool,
    },
    /// A file of the layout is missing or cannot be parsed at all.
    #[error("{file}: {reason}")]
    File {
        /// The file.
        file: String,
        /// The reason.
        reason: String,
    },
    /// A field of a file is missing or has an unusable value.
    #[error("{file}: {field}: {reason}")]
    Field {
        /// The file.
        file: String,
        /// The field, as a path like `frames[3].transform_matrix`.
        field: String,
        /// The reason.
        reason: String,
    },
    /// An image cannot be used.
    #[error("{file}: {reason}")]
    Image {
        /// The image.
        file: String,
        /// The reason.
        reason: String,
    },
    /// There are too few photographs to train on.
    #[error("{file}: usable photographs: {usable}; at least {required} are needed{}", missing_note(.missing))]
    TooFewImages {
        /// The file that lists the images.
        file: String,
        /// Images found.
        usable: usize,
        /// Images needed.
        required: usize,
        /// Images that are listed but absent.
        missing: Vec<String>,
    },
}

/// The text of [`CaptureError::UnknownLayout`], with what to add to the files.
fn unknown_layout(reason: &str, has_photographs: bool) -> String {
    const LAYOUTS: &str = "transforms_train.json (NeRF-synthetic, TensoIR), transforms.json (nerfstudio), sparse/0 (COLMAP) or \
                           poses_bounds.npy (LLFF)";
    if has_photographs {
        return format!(
            "unknown layout: {reason}; expected {LAYOUTS}; `relume capture poses` and `relume train` compute the poses of photographs \
             without poses"
        );
    }
    format!(
        "{reason}; put at least {MIN_IMAGES} photographs into it, better 40 to 200, as JPEG, PNG, TIFF, WebP, HEIC or AVIF files, and \
         their poses if you have them: {LAYOUTS}"
    )
}

fn missing_note(missing: &[String]) -> String {
    if missing.is_empty() { String::new() } else { format!("; missing: {}", name_list(missing)) }
}

/// Names joined by commas; beyond 64, a count of the rest.
pub(super) fn name_list(names: &[String]) -> String {
    const SHOWN: usize = 64;
    let listed = names.iter().take(SHOWN).map(|name| shown(name)).collect::<Vec<_>>().join(", ");
    if names.len() > SHOWN { format!("{listed} and {} more", names.len() - SHOWN) } else { listed }
}

impl CaptureError {
    /// [`CaptureError::Field`].
    pub(super) fn at_field(file: &str, field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Field { file: shown(file), field: shown(&field.into()), reason: reason.into() }
    }

    /// [`CaptureError::OverLimit`].
    pub(super) fn over_limit(file: &str, limit: &'static str, reason: impl Into<String>) -> Self {
        Self::OverLimit { file: shown(file), limit, reason: reason.into() }
    }

    /// [`CaptureError::Image`].
    pub(super) fn image(file: &str, reason: impl std::fmt::Display) -> Self {
        Self::Image { file: shown(file), reason: reason.to_string() }
    }

    /// A stable identifier of the kind of error, for APIs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Io { .. } => "capture_io",
            Self::ArchiveDamaged { .. } => "capture_archive_damaged",
            Self::UnsafeEntry { .. } => "capture_archive_unsafe",
            Self::OverLimit { .. } => "capture_over_limit",
            Self::UnknownLayout { .. } => "capture_layout_unknown",
            Self::File { .. } => "capture_file_invalid",
            Self::Field { .. } => "capture_field_invalid",
            Self::Image { .. } => "capture_image_invalid",
            Self::TooFewImages { .. } => "capture_too_few_images",
        }
    }

    /// The file at fault, relative to the capture, when there is one.
    pub fn file(&self) -> Option<&str> {
        match self {
            Self::UnknownLayout { .. } => None,
            Self::Io { file, .. }
            | Self::ArchiveDamaged { file, .. }
            | Self::UnsafeEntry { file, .. }
            | Self::OverLimit { file, .. }
            | Self::File { file, .. }
            | Self::Field { file, .. }
            | Self::Image { file, .. }
            | Self::TooFewImages { file, .. } => Some(file),
        }
    }

    /// The field at fault inside [`Self::file`], when there is one.
    pub fn field(&self) -> Option<&str> {
        match self {
            Self::Field { field, .. } => Some(field),
            Self::OverLimit { limit, .. } => Some(limit),
            _ => None,
        }
    }

    /// True when the caller's data is at fault, false when the machine is.
    pub fn is_users_fault(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}
