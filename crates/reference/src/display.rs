//! Conversion of scene-referred radiance to display values, which are compared with a photograph.

use super::array::Array;
use super::tape::Var;

/// Radiance clamped to [0, peak] and, if `srgb`, encoded by the sRGB curve, whose power continues above 1.
///
/// Below 0 no gradient passes. Above the peak a gradient passes, with the derivative at the peak, only where a step along it lowers the
/// radiance, so that over-bright pixels can recover.
pub fn display(radiance: Var<'_>, srgb: bool, peak: f64) -> Var<'_> {
    let x = radiance.value();
    let curve = |x: f64| if srgb { srgb_curve(x) } else { x };
    let derivative = move |x: f64| if srgb { srgb_derivative(x) } else { 1.0 };
    let shown = x.map(|x| curve(x.clamp(0.0, peak)));
    radiance.tape.custom(&[radiance], shown, move |g| {
        let backward = |(&x, &g): (&f64, &f64)| match x {
            x if x < 0.0 => 0.0,
            x if x > peak => derivative(peak) * g.max(0.0),
            x => derivative(x) * g,
        };
        vec![Array::new(g.shape(), x.data().iter().zip(g.data()).map(backward).collect())]
    })
}

/// The sRGB transfer curve (IEC 61966-2-1); above 1 its power continues.
fn srgb_curve(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

fn srgb_derivative(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * x.powf(1.0 / 2.4 - 1.0) }
}

#[cfg(test)]
mod tests {
    use super::super::tape::Tape;
    use super::*;

    fn gradients(radiance: [f64; 4], by_image: [f64; 4], peak: f64) -> Vec<f64> {
        let tape = Tape::new();
        let x = tape.input(Array::new(&[4], radiance.to_vec()));
        let loss = (display(x, true, peak) * tape.input(Array::new(&[4], by_image.to_vec()))).sum();
        tape.gradients(loss).of(x).data().to_vec()
    }

    #[test]
    fn gradient_of_over_bright_pixels_can_only_darken_them() {
        let told_to_darken = gradients([-0.5, 0.25, 1.0, 3.0], [2.0; 4], 1.0);
        let told_to_brighten = gradients([-0.5, 0.25, 1.0, 3.0], [-2.0; 4], 1.0);
        let derivative = 1.055 / 2.4;
        assert_eq!(told_to_darken[0], 0.0);
        assert!((told_to_darken[3] - 2.0 * derivative).abs() < 1e-12);
        assert_eq!(told_to_brighten[3], 0.0);
        assert!(told_to_brighten[1] < 0.0 && told_to_brighten[2] < 0.0);
        // Up to a higher peak pixels can become brighter.
        let [.., below_peak] = gradients([-0.5, 0.25, 1.0, 3.0], [-2.0; 4], 64.0)[..] else { panic!() };
        assert!((below_peak + 2.0 * srgb_derivative(3.0)).abs() < 1e-12, "{below_peak}");
    }

    #[test]
    fn srgb_derivative_agrees_with_central_differences() {
        for x in [1e-3, 0.02, 0.5, 0.99] {
            let numeric = (srgb_curve(x + 1e-7) - srgb_curve(x - 1e-7)) / 2e-7;
            assert!((srgb_derivative(x) - numeric).abs() < 1e-6, "{x}");
        }
        assert!((srgb_curve(0.214_041_140_482_232) - 0.5).abs() < 1e-9);
        assert_eq!(srgb_curve(1.0), 1.055 - 0.055);
    }
}
