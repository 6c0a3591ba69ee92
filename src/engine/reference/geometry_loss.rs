//! The depth-normal term: shading normals should agree with the surface that the splats' planes describe.

use super::array::Array;
use super::ops::concat;
use super::tape::Var;

/// What the term looks at, each (H, W, C).
pub struct Surface<'t> {
    /// Coverage (1).
    pub coverage: Var<'t>,
    /// Unit shading normals, turned to the camera (3).
    pub normal: Var<'t>,
    /// Blended normals, not of unit length (3).
    pub blended_normal: Var<'t>,
    /// Blended plane distances under the same division (1).
    pub plane: Var<'t>,
    /// Unit directions from the camera through the pixels (3).
    pub rays: Var<'t>,
}

/// Planes seen at a flatter cosine than this have no reliable intersection.
const FLATTEST: f64 = 1e-2;
/// Pixels covered less than this show no surface.
const LEAST_COVERAGE: f64 = 1e-3;

/// `mean coverage (1 - n . n_d)` over the image (docs/MODEL.md section 5).
///
/// `n_d` is the normal, turned to the camera, of central differences between the points
/// `ray D / (N . ray)` of the four neighbours; where one of them shows no surface the pixel counts as 0.
pub fn depth_normal<'t>(surface: &Surface<'t>) -> Var<'t> {
    let tape = surface.coverage.tape;
    let [height, width] = [0, 1].map(|axis| surface.coverage.value().shape()[axis]);
    if height < 3 || width < 3 {
        return tape.scalar(0.0);
    }
    let slant = surface.blended_normal.dot(surface.rays);
    let shown = shown(&slant.value(), &surface.coverage.value());
    // Where nothing is shown the quotient only has to be finite.
    let hidden = tape.input(shown.map(|s| 1.0 - s));
    let points = surface.rays * surface.plane / (slant * tape.input(shown.clone()) + hidden);

    let crop = |x: Var<'t>, row: usize, column: usize| {
        x.slice(0, row..row + height - 2).slice(1, column..column + width - 2)
    };
    let right = crop(points, 1, 2) - crop(points, 1, 0);
    let down = crop(points, 2, 1) - crop(points, 0, 1);
    // In OpenCV axes right x down points into the scene, down x right at the camera.
    let from_depth = cross(down, right).normalised();
    let shown = tape.input(shown);
    let counted = [(1, 1), (1, 0), (1, 2), (0, 1), (2, 1)].map(|(r, c)| crop(shown, r, c));
    let counted = counted.into_iter().reduce(|all, one| all * one).unwrap_or(shown);
    let disagreement = 1.0 - crop(surface.normal, 1, 1).dot(from_depth);
    (crop(surface.coverage, 1, 1) * counted * disagreement).sum() * (1.0 / (height * width) as f64)
}

/// 1 where a surface is seen under a usable angle, else 0.
fn shown(slant: &Array, coverage: &Array) -> Array {
    let shown = |(s, c): (&f64, &f64)| f64::from(u8::from(s.abs() > FLATTEST && *c >= LEAST_COVERAGE));
    Array::new(slant.shape(), slant.data().iter().zip(coverage.data()).map(shown).collect())
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
