//! The matrix between the colours of a chart in a photograph and its reference colours.

use glam::{DMat3, DVec3};

use crate::colour_chart::delta_e::DeltaE;
use crate::colour_chart::reference::PATCHES;

/// Luminance of linear Rec.709 (ITU-R BT.709).
const LUMINANCE: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);
/// Luminance below which the weight of a patch grows no more: flare and noise matter there.
const DARK: f64 = 0.05;
/// Least number of patches.
const MIN_PATCHES: usize = 12;
/// Least determinant of the second moments over the cube of their mean diagonal. It is 0 for a photograph without colours.
const MIN_SPREAD: f64 = 1e-6;
/// Largest magnitude of an entry of the applied matrix: a white balance from candle light to daylight has 5.
const MAX_ENTRY: f64 = 10.0;
/// Least determinant of the applied matrix.
const MIN_DETERMINANT: f64 = 0.02;

/// A fitted matrix and its errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fit {
    /// From linear colours of the photograph to reflectance, linear Rec.709.
    pub to_reflectance: DMat3,
    /// Differences of the colours from the reference with the best exposure alone.
    pub before: DeltaE,
    /// Differences with the matrix.
    pub after: DeltaE,
}

/// Fits the matrix to pairs of colours: in the photograph and of the reference. It minimises
/// `sum_i w_i |M p_i - r_i|^2` with `w_i = (Y_i + 0.05)^(-4/3)` of the reference luminance `Y_i`: the square of the slope of CIE L*, up to a
/// factor, so that bright patches do not outweigh dark ones.
///
/// # Errors
/// In words: too few patches, or a photograph without colours.
pub(super) fn fit(pairs: &[(DVec3, DVec3)]) -> Result<Fit, String> {
    if pairs.len() < MIN_PATCHES {
        return Err(format!(
            "only {} of {PATCHES} patches are usable; at least {MIN_PATCHES} are needed",
            pairs.len()
        ));
    }
    let (mut cross, mut moments) = (DMat3::ZERO, DMat3::ZERO);
    let (mut dot, mut square) = (0.0, 0.0);
    for (p, r) in pairs {
        let weight = (r.dot(LUMINANCE).max(0.0) + DARK).powf(-4.0 / 3.0);
        cross += weight * outer(*r, *p);
        moments += weight * outer(*p, *p);
        dot += weight * p.dot(*r);
        square += weight * p.dot(*p);
    }
    let diagonal = (moments.x_axis.x + moments.y_axis.y + moments.z_axis.z) / 3.0;
    if !(moments.determinant() > MIN_SPREAD * diagonal.powi(3)) {
        return Err("the photograph shows no different colours there; it must not be monochrome".to_owned());
    }
    let to_reflectance = cross * moments.inverse();
    let errors = |map: DMat3| DeltaE::of(pairs.iter().map(|(p, r)| (map * *p, *r)));
    let (before, after) = (errors(DMat3::from_diagonal(DVec3::splat(dot / square))), errors(to_reflectance));
    let (Some(before), Some(after)) = (before, after) else { return Err("no patch is usable".to_owned()) };
    Ok(Fit { to_reflectance, before, after })
}

/// `a b^T`.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

impl Fit {
    /// The matrix that is applied to photographs: a multiple of [`Self::to_reflectance`] that keeps the brightest channel of a neutral
    /// surface in the light of the chart. A neutral surface that is clipped in that channel is then white.
    ///
    /// # Errors
    /// In words: a matrix that no camera has.
    pub(super) fn applied(&self) -> Result<DMat3, String> {
        let unusable = |why: &str| format!("its colours give a matrix that no camera has ({why})");
        if !(self.to_reflectance.determinant() > 0.0) {
            return Err(unusable("it is not invertible"));
        }
        let white = self.to_reflectance.inverse() * DVec3::ONE;
        if !(white.min_element() > 0.0) {
            return Err(unusable("white is not positive"));
        }
        let applied = white.max_element() * self.to_reflectance;
        if !applied.to_cols_array().iter().all(|v| v.abs() <= MAX_ENTRY) {
            return Err(unusable(&format!("an entry is larger than {MAX_ENTRY}")));
        }
        if !(applied.determinant() >= MIN_DETERMINANT) {
            return Err(unusable("its determinant is almost 0"));
        }
        Ok(applied)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colour_chart::reference::reflectances;
    use relume_compare::largest_difference;
    use relume_spec::training::ChartEdition;

    /// Colours of a photograph of the chart by a camera that has the inverse of this matrix, in columns.
    const CAMERA: DMat3 = DMat3::from_cols(
        DVec3::new(0.70, 0.10, 0.02),
        DVec3::new(0.15, 0.50, 0.08),
        DVec3::new(0.05, 0.06, 0.25),
    );

    fn pairs(camera: impl Fn(DVec3) -> DVec3) -> Vec<(DVec3, DVec3)> {
        reflectances(ChartEdition::SinceNovember2014).map(|r| (camera(r), r)).to_vec()
    }

    #[test]
    fn fit_recovers_the_matrix_of_the_camera() {
        let fit = fit(&pairs(|r| CAMERA * r)).unwrap();
        let off =
            |wanted: DMat3| largest_difference(&fit.to_reflectance.to_cols_array(), &wanted.to_cols_array());
        assert!(off(CAMERA.inverse()) < 1e-9);
        assert!(off(CAMERA.inverse().transpose()) > 0.1 && off(CAMERA) > 0.1, "the controls");
        assert!(fit.after.max < 1e-6 && fit.before.mean > 8.0, "{fit:?}");
        let applied = fit.applied().unwrap();
        let white = CAMERA * DVec3::ONE;
        assert!((applied * white - DVec3::splat(white.max_element())).length() < 1e-9, "{applied}");
    }

    #[test]
    fn weights_keep_dark_patches_accurate() {
        // A camera whose colours no matrix corrects exactly.
        let curved = |r: DVec3| (CAMERA * r).max(DVec3::ZERO).powf(1.1);
        let fit = fit(&pairs(curved)).unwrap();
        assert!(fit.after.mean < 3.0 && fit.after.mean > 0.1 && fit.after.max < 8.0, "{:?}", fit.after);
        assert!(fit.after.mean < 0.4 * fit.before.mean, "{fit:?}");
    }

    #[test]
    fn photographs_without_colours_and_with_few_patches_are_refused() {
        let grey = fit(&pairs(|r| DVec3::splat(r.dot(LUMINANCE)))).unwrap_err();
        assert!(grey.contains("monochrome"), "{grey}");
        let all = pairs(|r| CAMERA * r);
        assert!(fit(&all[..11]).unwrap_err().contains("only 11 of 24"));
        assert!(fit(&all[..12]).is_ok(), "the control");
        assert!(fit(&pairs(|_| DVec3::NAN)).is_err());
    }

    #[test]
    fn matrices_that_no_camera_has_are_refused() {
        let refused = |camera: DMat3| fit(&pairs(|r| camera * r)).unwrap().applied().unwrap_err();
        let of = |x, y, z| DMat3::from_cols(x, y, z);
        assert!(refused(of(DVec3::Y, DVec3::X, DVec3::Z)).contains("invertible"), "red and green swapped");
        assert!(refused(DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.05))).contains("larger than"));
        assert!(fit(&pairs(|r| CAMERA * r)).unwrap().applied().is_ok(), "the control");
    }
}
