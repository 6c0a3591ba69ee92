//! Frames of a model under each lobe of light and each small light of an environment (docs/guide/light_matrix.md).

use std::io::{Seek, Write};
use std::ops::Range;

use rayon::prelude::*;

use crate::render::{FrameMetadata, RenderError, Renderer};
use relume_capture::formats::exr_matrix::{self, MatrixFile, MatrixFileError, MatrixLightPart};
use relume_engine::{LightMatrix, MatrixLight};
use relume_scene::light::LightLobes;
use relume_scene::{Camera, SplitLight};
use relume_spec::rendering::{AlphaMode, Background, ColourDepth};

/// Attributes of frames that say nothing about a matrix.
const OMITTED: [&str; 2] = ["relume:exposure_ev", "relume:background"];

/// The lights of a matrix, prepared for models with one degree of visibility. May be used for any number of cameras.
pub struct MatrixLights {
    prepared: MatrixLight,
    parts: Vec<MatrixLightPart>,
}

impl MatrixLights {
    /// The lights, in the order of their frames: lobes, then small lights.
    pub fn parts(&self) -> &[MatrixLightPart] {
        &self.parts
    }
}

/// The frames of a camera under each light, ready to be computed.
pub struct MatrixFrames<'a> {
    camera: Camera,
    matrix: LightMatrix<'a>,
    lights: &'a MatrixLights,
}

impl Renderer {
    /// The lights of a matrix for this model: `lobes` of radiance 1, and the small lights `suns` of irradiance 1.
    pub fn matrix_lights(&self, lobes: &LightLobes, suns: Vec<SplitLight>) -> MatrixLights {
        let of_lobes = lobes.directions().iter().zip(lobes.solid_angles()).map(|(d, w)| {
            let direction = d.to_array().map(|v| v as f32);
            MatrixLightPart::Lobe { direction, solid_angle: *w as f32 }
        });
        let parts = of_lobes.chain(suns.iter().copied().map(MatrixLightPart::Sun)).collect();
        let prepared = MatrixLight::new(lobes, suns, self.model().gaussians.visibility_degree());
        MatrixLights { prepared, parts }
    }

    /// Prepares the frames of a camera in capture coordinates under each of `lights`, at the tier `standard`. The CPU computes them, also
    /// where a graphics card renders other frames.
    ///
    /// # Errors
    /// Names the field of the camera that cannot be rendered.
    pub fn light_matrix<'a>(
        &'a self,
        camera: &Camera,
        lights: &'a MatrixLights,
    ) -> Result<MatrixFrames<'a>, RenderError> {
        let matrix = self.host().light_matrix(&lights.prepared, self.view(camera)?);
        Ok(MatrixFrames { camera: *camera, matrix, lights })
    }
}

impl MatrixFrames<'_> {
    /// Writes a multi-part EXR with the frames. `metadata` names model and light. `go_on` is called with the number of frames done, also
    /// from other threads; the file is abandoned once it returns false.
    ///
    /// # Errors
    /// If writing fails, or `go_on` returned false.
    pub fn write<W: Write + Seek>(
        &self,
        out: &mut W,
        depth: ColourDepth,
        metadata: &FrameMetadata,
        go_on: &(dyn Fn(usize) -> bool + Sync),
    ) -> Result<(), MatrixFileError> {
        let metadata = FrameMetadata { camera: Some(self.camera), ..metadata.clone() };
        let mut attributes = metadata.attributes(Background::Transparent, AlphaMode::Premultiplied);
        attributes.texts.retain(|(name, _)| !OMITTED.contains(name));
        attributes.texts.push((
            "relume:light_matrix",
            "picture = sum over parts of weight * part, per channel".to_owned(),
        ));
        let Camera { width, height, .. } = self.camera;
        let lights = self.lights.parts();
        let file = MatrixFile { width, height, lights, depth, attributes: &attributes };
        let done = std::sync::atomic::AtomicUsize::new(0);
        let is_wanted = || go_on(done.load(std::sync::atomic::Ordering::Relaxed));
        exr_matrix::write(out, &file, &is_wanted, |strips| {
            let coverage = self.matrix.coverage();
            strips.write(0..1, &|strip| self.matrix.strip(&coverage, strip))?;
            for Range { start, end } in self.matrix.groups() {
                let shaded = self.matrix.shade(start..end);
                strips.write(1 + start..1 + end, &|strip| self.matrix.strip(&shaded, strip))?;
                done.store(end, std::sync::atomic::Ordering::Relaxed);
            }
            Ok(())
        })
    }

    /// The sum of the frames, each times its weight: linear radiance RGB of each pixel, row-major, premultiplied. A missing weight is 0.
    pub fn weighted_sum(&self, weights: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let mut strips: Vec<Vec<[f32; 3]>> = vec![Vec::new(); self.matrix.strips()];
        for columns in self.matrix.groups() {
            let weights = weights.get(columns.clone()).or_else(|| weights.get(columns.start..));
            let shaded = self.matrix.shade(columns.clone());
            strips.par_iter_mut().enumerate().for_each(|(index, sums)| {
                let values = self.matrix.strip(&shaded, index);
                let pixels = values.len() / (3 * columns.len());
                sums.resize(pixels, [0.0; 3]);
                for (frame, weight) in
                    values.chunks_exact((3 * pixels).max(1)).zip(weights.unwrap_or_default())
                {
                    for (c, channel) in frame.chunks_exact(pixels.max(1)).enumerate() {
                        sums.iter_mut().zip(channel).for_each(|(sum, value)| sum[c] += weight[c] * value);
                    }
                }
            });
        }
        strips.concat()
    }
}
