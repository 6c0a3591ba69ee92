//! The objective: every term of Eq. 29 and of docs/MODEL.md, section 5, for one rendered view.

use std::collections::BTreeMap;

use super::array::Array;
use super::attributes::{field, from_camera};
use super::forward::{Conventions, Options, Stages, forward};
use super::geometry_loss::{DepthNormalInput, depth_normal};
use super::losses;
use super::model::{Arrays, ReferenceModel};
use super::projection::rays;
use super::tape::{Tape, Var};
use relume_scene::light::{DAYLIGHT, LightColour};
use relume_scene::{Camera, Field, VisibilityForm, texel_directions};

/// Tolerance of the term on the colour of the light.
pub const LIGHT_COLOUR_TOLERANCE: f64 = 0.03;

/// The target of a view.
#[derive(Debug, Clone, PartialEq)]
pub struct Target {
    /// The photograph over the pass's background, in display space, (H, W, 3).
    pub image: Array,
    /// Its mask, (H, W, 1), if the capture has one.
    pub coverage: Option<Array>,
    /// Measured visibility coefficients of every Gaussian, (N, (L + 1)^2), if probes were taken.
    pub probes: Option<Array>,
}

impl From<Array> for Target {
    fn from(image: Array) -> Self {
        Self { image, coverage: None, probes: None }
    }
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

/// Compares a pass with its target; `total` is the weighted sum.
pub fn objective<'t>(
    pass: &Stages<'t>,
    camera: &Camera,
    target: &Target,
    options: &Options,
    weights: &[(&str, f64)],
) -> Terms<'t> {
    let p = &pass.parameters;
    let tape = pass.image.tape;
    let mut terms = image_terms(pass, camera, target, options);
    terms.insert("light", losses::light_neutrality(p.environment()));
    if options.conventions == Conventions::Model {
        let [rows, columns] = p.environment_size();
        let texels = texel_directions(columns, rows);
        terms.insert("exposure", losses::exposure(p.environment(), &texels));
        let wanted = LightColour::of(DAYLIGHT);
        terms.insert(
            "light_colour",
            losses::light_colour(p.environment(), &texels, wanted, LIGHT_COLOUR_TOLERANCE),
        );
    }
    terms.insert("flatness", losses::flatness(p.get(Field::LogScale)));
    terms.insert("agg", losses::aggregation(p.assignment()));
    terms.insert("res", losses::residual_sparsity(p.get(Field::Residual)));
    terms.insert("occ", occlusion(pass, camera, options, Labels::Constant));
    if let Some(probes) = &target.probes {
        let measured = tape.input(probes.clone());
        terms.insert("probes", losses::probe_distance(p.get(Field::Visibility), measured));
    }
    terms.insert("total", weighted_sum(tape, &terms, weights));
    terms
}

/// The weighted sum of the named terms.
pub fn weighted_sum<'t>(tape: &'t Tape, terms: &Terms<'t>, weights: &[(&str, f64)]) -> Var<'t> {
    let weighted = weights.iter().filter_map(|(name, weight)| terms.get(name).map(|t| *t * *weight));
    weighted.fold(tape.scalar(0.0), |sum, term| sum + term)
}

/// The terms on pixels.
fn image_terms<'t>(pass: &Stages<'t>, camera: &Camera, target: &Target, options: &Options) -> Terms<'t> {
    let tape = pass.image.tape;
    let picture = |x: Var<'t>| {
        let channels = x.value().shape()[1];
        x.reshaped(&[camera.height as usize, camera.width as usize, channels])
    };
    let photograph = tape.input(target.image.clone());
    let window = options.conventions.ssim_window();
    let difference = |image| losses::mean_absolute_error(image, photograph);
    let dissimilarity = |image| losses::structural_dissimilarity(image, photograph, &window);
    let (image, radiance) = (picture(pass.image), picture(pass.radiance_image));
    let coverage = picture(pass.buffer.coverage);
    let surface = DepthNormalInput {
        coverage,
        normal: picture(pass.buffer.normal),
        plane: picture(pass.buffer.plane),
        rays: picture(tape.input(rays(camera))),
    };
    let normal = match options.conventions {
        Conventions::Listing => pass.shaded.normal,
        Conventions::Model => pass.buffer.normal,
    };
    // Attributes of pixels with almost no coverage are meaningless.
    let seen = tape.input(options.conventions.shaded(&pass.buffer.coverage.value()));
    let smooth = |x: Var<'t>| losses::edge_aware_smoothness(picture(x * seen), photograph);
    let mut terms = Terms::from([
        ("img_mae", difference(image)),
        ("img_dssim", dissimilarity(image)),
        ("radiance_mae", difference(radiance)),
        ("radiance_dssim", dissimilarity(radiance)),
        ("smooth_metal", smooth(pass.buffer.metal)),
        ("smooth_rough", smooth(pass.buffer.rough)),
        ("smooth_normal", smooth(normal)),
        ("depth_normal", depth_normal(&surface)),
    ]);
    if let Some(mask) = &target.coverage {
        terms.insert("coverage", losses::mean_absolute_error(coverage, tape.input(mask.clone())));
    }
    terms
}

/// Treatment of visibility labels: constants, or part of the differentiated function. Training uses constants; the gradient
/// through them serves to check the compositing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Labels {
    /// Labels and their directions are constants: only the coefficients have a gradient.
    Constant,
    /// Labels and directions depend on the geometry.
    Differentiated,
}

/// Visibility along the continued view rays against backward transmittance (Eq. 14-15), over the Gaussians with sufficient
/// weight in the view.
pub fn occlusion<'t>(pass: &Stages<'t>, camera: &Camera, options: &Options, labels: Labels) -> Var<'t> {
    let p = &pass.parameters;
    let tape = pass.image.tape;
    let data = |x: Var<'t>| if labels == Labels::Constant { x.detached() } else { x };
    let (backward, totals) = losses::backward_labels(&pass.weights);
    let totals = totals.value();
    let kept: Vec<usize> = (0..totals.len()).filter(|&i| totals.data()[i] > LABELLED).collect();
    if kept.is_empty() {
        return tape.scalar(0.0);
    }
    let gaussians: Vec<usize> = kept.iter().map(|&i| pass.splats.indices[i]).collect();
    let backward = data(backward).gather(0, &kept);
    let directions = data(from_camera(tape, p, camera).gather(0, &gaussians).normalised());
    let linear = field(p.get(Field::Visibility).gather(0, &gaussians), directions);
    let entropies = match options.shading.visibility {
        VisibilityForm::Sigmoid => losses::cross_entropy_of_logits(linear, backward),
        VisibilityForm::Linear | VisibilityForm::Off => losses::cross_entropy(linear, backward),
    };
    entropies.mean()
}

/// The value of every term of the objective, and the gradient of the weighted total by parameter.
pub fn loss_and_gradients(
    scene: &ReferenceModel,
    camera: &Camera,
    target: &Target,
    options: &Options,
    weights: &[(&str, f64)],
) -> (BTreeMap<&'static str, f64>, Arrays) {
    let tape = Tape::new();
    let pass = forward(&tape, scene, camera, options);
    let terms = objective(&pass, camera, target, options, weights);
    let gradients = pass.parameters.gradients(&tape.gradients(terms["total"]));
    (terms.iter().map(|(name, term)| (*name, term.value().data()[0])).collect(), gradients)
}
