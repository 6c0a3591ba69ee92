//! The depth-normal term, which aligns shading normals with the surface of the splats' planes.

use super::array::Array;
use super::ops::concat;
use super::tape::Var;

/// Inputs of the term, each (H, W, C).
pub struct DepthNormalInput<'t> {
    /// Coverage (1).
    pub coverage: Var<'t>,
    /// Blended normals divided by coverage, not of unit length (3).
    pub normal: Var<'t>,
    /// Blended plane distances divided by coverage (1).
    pub plane: Var<'t>,
    /// Directions from the camera through the pixels, `z_c = 1` (3).
    pub rays: Var<'t>,
}

/// Smallest coverage at which a pixel's depth is used.
const TRUSTED_COVERAGE: f64 = 0.5;
/// Smallest cosine between plane and ray at which their intersection is used.
const MIN_FACING: f64 = 0.05;
/// Largest depth that is used, world units.
const MAX_DEPTH: f64 = 1e4;
/// Largest relative difference of neighbouring depths on one surface; a larger one is an edge.
const MAX_DEPTH_STEP: f64 = 0.05;

/// `coverage (1 - n . n_d)`, summed over the pixels whose own, right and lower depths form a surface, divided by the number of
/// all pixels (docs/MODEL.md, section 5).
///
/// Depths are `t = D / (N . ray)`; `n_d` is the normal of the triangle of the three points `t ray`, towards
/// the camera. The choice of counted pixels has no gradient.
pub fn depth_normal<'t>(surface: &DepthNormalInput<'t>) -> Var<'t> {
    let tape = surface.coverage.tape;
    let [height, width] = [0, 1].map(|axis| surface.coverage.value().shape()[axis]);
    if height < 2 || width < 2 {
        return tape.scalar(0.0);
    }
    let facing = surface.normal.dot(surface.rays);
    let trusted = trusted(&surface.coverage.value(), &facing.value(), &surface.plane.value());
    // For other pixels the quotient must only be finite.
    let elsewhere = tape.input(trusted.map(|t| 1.0 - t));
    let depth = surface.plane / (facing * tape.input(trusted.clone()) + elsewhere);
    let counted = tape.input(surfaces(&depth.value(), &trusted));

    let crop = |x: Var<'t>, [row, column]: [usize; 2]| {
        x.slice(0, row..row + height - 1).slice(1, column..column + width - 1)
    };
    let points = surface.rays * depth;
    let [own, right, lower] = [[0, 0], [0, 1], [1, 0]].map(|at| crop(points, at));
    // In OpenCV axes right x down points into the scene, down x right at the camera.
    let from_depth = cross(lower - own, right - own).normalised();
    let disagreement = 1.0 - crop(surface.normal.normalised(), [0, 0]).dot(from_depth);
    let share = 1.0 / (height * width) as f64;
    (crop(surface.coverage, [0, 0]) * counted * disagreement).sum() * share
}

/// 1 where a pixel's plane has a usable depth, else 0.
fn trusted(coverage: &Array, facing: &Array, plane: &Array) -> Array {
    let usable = |i: usize| {
        let [coverage, facing, plane] = [coverage, facing, plane].map(|a| a.data()[i]);
        let depth = plane / facing;
        coverage >= TRUSTED_COVERAGE && facing * coverage < -MIN_FACING && depth > 0.0 && depth < MAX_DEPTH
    };
    Array::new(coverage.shape(), (0..coverage.len()).map(|i| f64::from(u8::from(usable(i)))).collect())
}

/// 1 where a pixel, its right and its lower neighbour lie on one surface, (H - 1, W - 1, 1).
fn surfaces(depth: &Array, trusted: &Array) -> Array {
    let [height, width] = [0, 1].map(|axis| depth.shape()[axis]);
    let one_surface = |own: usize| {
        let near = |i: usize| {
            let jump = (depth.data()[i] - depth.data()[own]).abs();
            trusted.data()[i] == 1.0 && jump <= MAX_DEPTH_STEP * depth.data()[own]
        };
        near(own) && near(own + 1) && near(own + width)
    };
    let own = (0..height - 1).flat_map(|y| (0..width - 1).map(move |x| y * width + x));
    let counted = own.map(|i| f64::from(u8::from(one_surface(i)))).collect();
    Array::new(&[height - 1, width - 1, 1], counted)
}

/// Cross product along the last axis.
fn cross<'t>(a: Var<'t>, b: Var<'t>) -> Var<'t> {
    let component = |i: usize| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        a.column(j) * b.column(k) - a.column(k) * b.column(j)
    };
    let last = a.value().shape().len() - 1;
    concat(a.tape, last, &[component(0), component(1), component(2)])
}
