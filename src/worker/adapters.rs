//! Stand-ins until the importers and encoders land; replaced by `capture::import` and `formats::*`.

use std::path::Path;

use crate::capture::{Capture, Scene3dBounds};
use crate::scene::EnvMap;

#[derive(Debug, thiserror::Error)]
#[error("{file}: {reason}")]
pub struct CaptureError {
    pub file: String,
    pub reason: String,
}
impl CaptureError {
    pub fn code(&self) -> &'static str {
        "capture_archive_damaged"
    }
    pub fn file(&self) -> Option<&str> {
        Some(&self.file)
    }
    pub fn field(&self) -> Option<&str> {
        None
    }
    pub fn is_users_fault(&self) -> bool {
        true
    }
}
pub fn import(path: &Path, _max_side: Option<u32>) -> Result<Capture, CaptureError> {
    let bad = |reason: String| CaptureError { file: "archive".into(), reason };
    let bytes = std::fs::read(path).map_err(|e| bad(e.to_string()))?;
    if !bytes.starts_with(b"PK") {
        return Err(bad("not an archive".into()));
    }
    Ok(Capture {
        layout: "stub".into(),
        train: vec![],
        test: vec![],
        points: vec![],
        bounds: Scene3dBounds { centre: glam::DVec3::ZERO, radius: 1.0 },
        has_alpha: true,
        lights: Default::default(),
        warnings: vec![],
    })
}
pub fn decode_environment(bytes: &[u8]) -> Result<(EnvMap, Vec<String>), String> {
    if bytes.is_empty() { Err("environment: empty".into()) } else { Ok((EnvMap::constant(4, 2, [1.0; 3]), vec![])) }
}
pub const BUILTINS: &[&str] = &["studio"];
pub fn builtin(name: &str) -> Option<EnvMap> {
    BUILTINS.contains(&name).then(|| EnvMap::constant(4, 2, [1.0; 3]))
}
pub fn ply(_model: &crate::scene::Model) -> Vec<u8> {
    b"ply\n".to_vec()
}
