//! Rendered frames: named planes of linear, scene-referred floats.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::engine::cpu::srgb;

/// A picture that can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Output {
    /// Relit linear radiance, premultiplied by alpha (3).
    Rgb,
    /// Linear base colour (3).
    Albedo,
    /// World-space unit normal; zero where nothing is (3).
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
    /// Diffuse part of `rgb`, premultiplied (3).
    Diffuse,
    /// Specular part of `rgb`, premultiplied (3).
    Specular,
    /// The radiance branch: the scene under its own light, linear, premultiplied (3).
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
    /// Display-referred 8-bit RGBA (straight alpha) of `rgb`: clamp, sRGB curve. Transparent black without `rgb`.
    pub fn to_srgb8(&self) -> Vec<[u8; 4]> {
        let pixels = self.width as usize * self.height as usize;
        let (Some(rgb), Some(alpha)) = (self.planes.get(&Output::Rgb), self.planes.get(&Output::Alpha))
        else {
            return vec![[0; 4]; pixels];
        };
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        rgb.chunks_exact(3)
            .zip(alpha)
            .map(|(c, a)| {
                let straight = |v: f32| byte(srgb((v / a.max(1e-6)).clamp(0.0, 1.0)));
                [straight(c[0]), straight(c[1]), straight(c[2]), byte(*a)]
            })
            .collect()
    }
}
