//! From scene-referred radiance to the image that is compared with a photograph.

use super::array::Array;
use super::tape::Var;

/// Radiance clamped to [0, 1] and put through the sRGB curve if `srgb`.
///
/// Below 0 no gradient passes. Above 1 a gradient passes, with the slope at 1, only where following it would
/// lower the radiance: over-bright pixels can recover.
pub fn display(radiance: Var<'_>, srgb: bool) -> Var<'_> {
    let x = radiance.value();
    let (curve, slope): (fn(f64) -> f64, fn(f64) -> f64) =
        if srgb { (srgb_curve, srgb_slope) } else { (|x| x, |_| 1.0) };
    let shown = x.map(|x| curve(x.clamp(0.0, 1.0)));
    radiance.tape.custom(&[radiance], shown, move |g| {
        let pull = |(&x, &g): (&f64, &f64)| match x {
            x if x < 0.0 => 0.0,
            x if x > 1.0 => slope(1.0) * g.max(0.0),
            x => slope(x) * g,
        };
        vec![Array::new(g.shape(), x.data().iter().zip(g.data()).map(pull).collect())]
    })
}

/// The sRGB transfer curve (IEC 61966-2-1) on [0, 1].
fn srgb_curve(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

fn srgb_slope(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * x.powf(1.0 / 2.4 - 1.0) }
}
