//! A case for every engine, and its result.

use crate::{Arrays, TableOperators};
use relume_engine::cpu::BufferGradient;
use relume_scene::light::{EnvOperators, TableResolution};
use relume_scene::{Camera, DisplayRange, LightSplit, MAX_LIGHTS, Model};

/// Table operators for environments of one size, for the reference and for the other engines.
pub struct LightShape {
    pub(super) tables: TableOperators,
    pub(super) operators: EnvOperators,
}

impl LightShape {
    /// Operators for environments of `width` x `height` texels and visibility of degree `sh_degree`.
    pub fn new(width: usize, height: usize, sh_degree: usize, resolution: TableResolution) -> Self {
        Self {
            tables: TableOperators::new(width, height, resolution),
            operators: EnvOperators::new(width, height, sh_degree, resolution),
        }
    }

    /// The same operators with the dominant lights of `split`.
    #[must_use]
    pub fn with_lights(&self, split: &LightSplit) -> Self {
        Self { tables: self.tables.with_lights(split), operators: self.operators.with_lights(split) }
    }
}

/// A view, and the weights of a scalar whose gradient is computed: a weighted sum over both images and over the normal, plane,
/// metalness, roughness and coverage buffers. The GPU engine omits learned indirect light.
pub struct ParityCase<'a> {
    /// The model.
    pub model: &'a Model,
    /// The camera, in the model's world.
    pub camera: &'a Camera,
    /// Background, display-referred.
    pub background: [f32; 3],
    /// Range of the display values of the images.
    pub range: DisplayRange,
    /// Measured indirect light per Gaussian; empty: none.
    pub gathered: &'a [[f32; 6]],
    /// Arriving share of each dominant light per Gaussian; empty: 1.
    pub arriving: &'a [[f32; MAX_LIGHTS]],
    /// Operators for the size of the model's environment.
    pub light: &'a LightShape,
    /// Weights of the physically based image, row-major.
    pub physical: Vec<[f32; 3]>,
    /// Weights of the radiance branch.
    pub radiance: Vec<[f32; 3]>,
    /// Weights of the buffers (blended, not divided by coverage).
    pub buffers: Vec<BufferGradient>,
}

/// A splat in front of the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VisibleSplat {
    /// Index of the Gaussian.
    pub gaussian: usize,
    /// Projected mean, pixels.
    pub mean: [f64; 2],
    /// Inverse screen covariance xx, xy, yy.
    pub conic: [f64; 3],
}

/// An engine's result.
#[derive(Debug, Clone)]
pub struct ParityResult {
    /// The physically based image: display values in the range of the case.
    pub physical: Vec<[f64; 3]>,
    /// The radiance branch: display values.
    pub radiance: Vec<[f64; 3]>,
    /// Accumulated alpha.
    pub coverage: Vec<f64>,
    /// Gradients by parameter name of the reference.
    pub gradients: Arrays,
    /// Drawn splats, in the order of the Gaussians.
    pub splats: Vec<VisibleSplat>,
}

impl ParityResult {
    /// True when every pixel and gradient is a finite number.
    pub fn is_finite(&self) -> bool {
        let images = self.physical.iter().chain(&self.radiance).flatten().chain(&self.coverage);
        let gradients = self.gradients.values().flat_map(|a| a.data());
        images.chain(gradients).all(|v| v.is_finite())
    }
}

impl<'a> ParityCase<'a> {
    /// The case with seeded weights in [-1, 1); without gathered light.
    pub fn new(
        model: &'a Model,
        camera: &'a Camera,
        background: [f32; 3],
        light: &'a LightShape,
        seed: u64,
    ) -> Self {
        let mut state = seed ^ 0x5eed;
        let mut next = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / 8_388_608.0 - 1.0
        };
        let pixels = camera.width as usize * camera.height as usize;
        let mut triple = || [next(), next(), next()];
        let physical = (0..pixels).map(|_| triple()).collect();
        let radiance = (0..pixels).map(|_| triple()).collect();
        let buffers = (0..pixels)
            .map(|_| {
                let (normal, [plane, metal, rough]) = (triple(), triple());
                BufferGradient { normal, plane, metal, rough, coverage: metal - rough }
            })
            .collect();
        let range = DisplayRange::Unit;
        Self {
            model,
            camera,
            background,
            range,
            gathered: &[],
            arriving: &[],
            light,
            physical,
            radiance,
            buffers,
        }
    }

    /// Sets the weights to zero of pixels that are false in `counted`.
    pub fn keep(&mut self, counted: &[bool]) {
        for (i, _) in counted.iter().enumerate().filter(|(_, counted)| !**counted) {
            self.physical[i] = [0.0; 3];
            self.radiance[i] = [0.0; 3];
            self.buffers[i] = BufferGradient::default();
        }
    }

    pub(super) fn pixels(&self) -> usize {
        self.physical.len()
    }
}
