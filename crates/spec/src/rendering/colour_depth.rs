//! Number type of colours in an EXR.

use serde::{Deserialize, Serialize};

/// Number type of colours in an EXR. `half`: 16-bit floats; larger values are clamped to 65,504. `float`:
/// 32-bit floats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ColourDepth {
    /// 16-bit floats. Larger values are clamped to 65,504.
    Half,
    /// 32-bit floats.
    #[serde(rename = "float")]
    Full,
}
