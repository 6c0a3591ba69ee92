//! The split of an environment into dominant lights (strong and small) and the rest. The build script of `relume-engine`
//! generates the shaders' constants from it (`build/generated.rs`).

/// Maximum number of dominant lights of an environment.
pub const MAX_LIGHTS: usize = 4;

/// A distant small light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SplitLight {
    /// Unit direction towards it.
    pub direction: [f32; 3],
    /// Angular radius of a disc with the same angular spread, radians.
    pub radius: f32,
}

/// The split of an environment into dominant lights and the rest. A light's irradiance is the sum of its shares of texels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LightSplit {
    /// At most [`MAX_LIGHTS`]; empty where the environment is not split.
    pub lights: Vec<SplitLight>,
    /// Per texel, row-major: the share of its radiance that belongs to each light, each 0 to 1, their sum at most 1; 0
    /// beyond the last light. Empty without lights.
    pub shares: Vec<[f32; MAX_LIGHTS]>,
}

impl LightSplit {
    /// True where the split has no light.
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    /// Share of texel `i` that belongs to no light, 0 to 1.
    pub fn rest(&self, i: usize) -> f32 {
        self.shares.get(i).map_or(1.0, |m| (1.0 - m.iter().sum::<f32>()).clamp(0.0, 1.0))
    }

    /// The first error of the split for an environment of `texels` texels; `None` for a valid one.
    pub fn fault(&self, texels: usize) -> Option<&'static str> {
        let unit = |d: [f32; 3]| (d.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-3;
        let is_light = |l: &SplitLight| unit(l.direction) && (0.0..=1.6).contains(&l.radius);
        let is_share = |m: &[f32; MAX_LIGHTS]| {
            m.iter().all(|s| (0.0..=1.0).contains(s))
                && m.iter().sum::<f32>() <= 1.0 + 1e-5
                && m[self.lights.len()..].iter().all(|s| *s == 0.0)
        };
        if self.lights.len() > MAX_LIGHTS {
            Some("are more than four")
        } else if !self.lights.iter().all(is_light) {
            Some("have a direction that is not of unit length or a radius out of range")
        } else if self.shares.len() != if self.is_empty() { 0 } else { texels } {
            Some("have shares of another number of texels")
        } else if !self.shares.iter().all(is_share) {
            Some("have shares outside of 0 to 1")
        } else {
            None
        }
    }
}
