//! The oracle: f64, dense, straight from the equations, never tuned for speed.
//!
//! Everything is recorded on a [`Tape`], so any gradient of any intermediate value is at hand: [`forward`] for
//! the pieces, [`objective`] for the loss terms, [`Tape::gradients`] for the rest.

mod array;
mod compositing;
mod gbuffer;
pub mod losses;
mod ops;
mod projection;
mod quadrature;
mod scene;
mod shading;
mod spherical;
mod tape;

use std::collections::BTreeMap;

pub use array::Array;
pub use compositing::{AlphaLimits, Weights};
pub use gbuffer::GBuffer;
pub use ops::{Order, concat};
pub use projection::{NEAR, Splats};
pub use quadrature::Quadrature;
pub use scene::{Arrays, ENVIRONMENT, PROTOTYPES, Parameters, Scene, SceneError, parameter_names};
pub use shading::Shaded;
pub use spherical::{CLAMPED_COSINE, fibonacci_sphere, normal_related_sh, real_sh};
pub use tape::{Gradients, Tape, Var};

use crate::scene::{Camera, Field};

/// Choices of the forward model.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Screen-space low-pass, px^2.
    pub low_pass: f64,
    /// Scale opacity so that the low-pass keeps a splat's weight.
    pub low_pass_compensation: bool,
    /// From footprint to alpha.
    pub alpha: AlphaLimits,
    /// Colour behind everything, in the space images are compared in.
    pub background: [f64; 3],
    /// Tables of the light.
    pub light: Quadrature,
}

/// Every stage of one rendered view.
pub struct Pass<'t> {
    /// The scene's parameters.
    pub parameters: Parameters<'t>,
    /// The projected Gaussians.
    pub splats: Splats<'t>,
    /// Their blending weights.
    pub weights: Weights<'t>,
    /// The blended attributes.
    pub buffer: GBuffer<'t>,
    /// The shaded pixels.
    pub shaded: Shaded<'t>,
    /// The display image over the background, (P, 3).
    pub image: Var<'t>,
}

/// Renders a scene, keeping every stage on the tape.
pub fn forward<'t>(tape: &'t Tape, scene: &Scene, camera: &Camera, options: &Options) -> Pass<'t> {
    let parameters = Parameters::new(tape, scene);
    let p = &parameters;
    let splats = projection::project(tape, p, camera, options.low_pass);
    let mut opacities = p.get(Field::OpacityLogit).sigmoid().gather(0, &splats.indices);
    if options.low_pass_compensation {
        opacities = opacities * splats.compensation;
    }
    let weights = compositing::composite(tape, &splats, opacities, camera, options.alpha);
    let normals = p.get(Field::Normal).normalised();
    let indirect = shading::learned_indirect(tape, p, &options.light);
    let buffer = gbuffer::blend(tape, p, &splats, &weights, normals, indirect);
    let shaded = shading::shade(tape, p, &buffer, camera, &options.light);
    let background = tape.input(Array::new(&[1, 3], options.background.to_vec()));
    let display = (shaded.diffuse + shaded.specular).clamp(0.0, 1.0);
    let image = display * weights.alpha + background * (1.0 - weights.alpha);
    Pass { parameters, splats, weights, buffer, shaded, image }
}

/// The terms of the objective by name, each of shape (1).
pub type Terms<'t> = BTreeMap<&'static str, Var<'t>>;

/// Weights of the listing: a term's name and its factor in the total.
pub const LISTING_WEIGHTS: [(&str, f64); 9] = [
    ("img_mae", 1.0),
    ("img_dssim", 1.0),
    ("light", 0.01),
    ("smooth_metal", 0.01),
    ("smooth_rough", 0.01),
    ("smooth_normal", 0.01),
    ("occ", 0.1),
    ("agg", 0.01),
    ("res", 0.01),
];

/// Smallest summed weight at which a Gaussian's backward label counts.
const LABELLED: f64 = 1e-3;

/// Measures a pass against a photograph (H, W, 3); `total` is the sum under `weights`.
pub fn objective<'t>(pass: &Pass<'t>, camera: &Camera, target: &Array, weights: &[(&str, f64)]) -> Terms<'t> {
    let p = &pass.parameters;
    let tape = pass.image.tape;
    let target = tape.input(target.clone());
    let picture = |x: Var<'t>| {
        let channels = x.value().shape()[1];
        x.reshaped(&[camera.height as usize, camera.width as usize, channels])
    };
    let image = picture(pass.image);
    let window = losses::gaussian_window(7, 1.5);
    let smooth = |x: Var<'t>| losses::edge_aware_smoothness(picture(x), target);
    let mut terms = Terms::from([
        ("img_mae", losses::mean_absolute_error(image, target)),
        ("img_dssim", losses::structural_dissimilarity(image, target, &window)),
        ("light", losses::light_neutrality(p.environment())),
        ("smooth_metal", smooth(pass.buffer.metal)),
        ("smooth_rough", smooth(pass.buffer.rough)),
        ("smooth_normal", smooth(pass.shaded.normal)),
        ("occ", occlusion(pass, camera)),
        ("agg", losses::aggregation(p.assignment())),
        ("res", losses::residual_sparsity(p.get(Field::Residual))),
    ]);
    let weighted = weights.iter().filter_map(|(name, weight)| terms.get(name).map(|t| *t * *weight));
    let total = weighted.fold(tape.scalar(0.0), |sum, term| sum + term);
    terms.insert("total", total);
    terms
}

/// Visibility along the continued view rays against backward transmittance (Eq. 15). Labels and directions
/// are data: only the coefficients learn from this term.
fn occlusion<'t>(pass: &Pass<'t>, camera: &Camera) -> Var<'t> {
    let p = &pass.parameters;
    let tape = pass.image.tape;
    let (labels, totals) = losses::backward_labels(&pass.weights);
    let kept: Vec<usize> = (0..labels.len()).filter(|&i| totals.data()[i] > LABELLED).collect();
    if kept.is_empty() {
        return tape.scalar(0.0);
    }
    let gaussians: Vec<usize> = kept.iter().map(|&i| pass.splats.indices[i]).collect();
    let centre = tape.input(Array::new(&[1, 3], camera.centre().to_array().to_vec()));
    let directions = (p.get(Field::Mean).gather(0, &gaussians) - centre).normalised().detached();
    let coefficients = p.get(Field::Visibility).gather(0, &gaussians);
    let order = (coefficients.value().shape()[1] as f64).sqrt() as usize - 1;
    let logits = coefficients.dot(real_sh(directions, order));
    losses::binary_cross_entropy(logits, tape.input(labels).gather(0, &kept))
}
