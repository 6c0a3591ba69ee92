//! The order of the corners of a chart, and the fit in it.

use glam::{DMat3, DVec2, DVec3};

use crate::colour_chart::fit::{Fit, fit};
use crate::colour_chart::reference::{NAMES, reflectances};
use crate::colour_chart::sampling::{colours, homography};
use relume_scene::{DisplayRange, ImageRgba};
use relume_spec::training::ChartEdition;

/// Largest accepted mean CIEDE2000 with the matrix. The wrong orders of the corners in the tests have 9 or more; photographs of real charts
/// were not measured.
const MAX_MEAN: f64 = 7.0;
/// Another order of the corners replaces the given one if its mean CIEDE2000 is smaller than that of the given one by this factor.
const MUCH_BETTER: f64 = 0.5;

/// The orders in which the corners may be given: the right one, then turned and mirrored.
const ORDERS: [[usize; 4]; 8] = [
    [0, 1, 2, 3],
    [1, 2, 3, 0],
    [2, 3, 0, 1],
    [3, 0, 1, 2],
    [0, 3, 2, 1],
    [3, 2, 1, 0],
    [2, 1, 0, 3],
    [1, 0, 3, 2],
];

/// A chart that was found at the given corners.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FittedChart {
    pub fit: Fit,
    /// The map from the unit square to the chart.
    pub map: DMat3,
    /// Positions of dark skin, bluish green, black and white in the given corners.
    pub order: [usize; 4],
    /// Patches that were left out, with the reason.
    pub left_out: Vec<String>,
}

impl FittedChart {
    /// True if the corners were given in another order.
    pub(super) fn is_reordered(&self) -> bool {
        self.order != ORDERS[0]
    }
}

/// Fits the chart at `corners` of `photograph`, in the order that its colours show.
///
/// # Errors
/// A sentence with the reason and with what the user should check.
pub(super) fn fit_chart(
    photograph: &ImageRgba,
    range: DisplayRange,
    corners: [DVec2; 4],
    edition: ChartEdition,
) -> Result<FittedChart, String> {
    let in_order = |order| fit_in_order(photograph, range, corners, edition, order);
    let given = in_order(ORDERS[0]);
    let others = ORDERS[1..].iter().filter_map(|order| in_order(*order).ok());
    let best = others.min_by(|a, b| a.fit.after.mean.total_cmp(&b.fit.after.mean));
    let limit = given.as_ref().map_or(f64::INFINITY, |given| MUCH_BETTER * given.fit.after.mean);
    if let Some(best) = best
        && best.fit.after.mean < limit.min(MAX_MEAN)
    {
        return Ok(best);
    }
    let given = given?;
    let mean = given.fit.after.mean;
    if mean <= MAX_MEAN {
        return Ok(given);
    }
    Err(format!(
        "the colours there do not fit the chart in any order of the corners: the mean CIEDE2000 with the best matrix is {mean:.1}, more than \
         {MAX_MEAN}; give the outer corners of the patches dark skin, bluish green, black and white, in this order, and check that \
         they are those of this photograph as it is stored, that it shows a classic chart of 24 patches in even light, and `edition`"
    ))
}

fn fit_in_order(
    photograph: &ImageRgba,
    range: DisplayRange,
    corners: [DVec2; 4],
    edition: ChartEdition,
    order: [usize; 4],
) -> Result<FittedChart, String> {
    let map = homography(order.map(|i| corners[i])).ok_or("the corners are not those of a quadrilateral")?;
    let measured = colours(photograph, range, &map);
    let mut left_out = Vec::new();
    let mut pairs: Vec<(DVec3, DVec3)> = Vec::new();
    for ((colour, reflectance), name) in measured.into_iter().zip(reflectances(edition)).zip(NAMES) {
        match colour {
            Ok(colour) => pairs.push((colour, reflectance)),
            Err(why) => left_out.push(format!("{name}: {}", why.reason())),
        }
    }
    let fit = fit(&pairs).map_err(|reason| match left_out.is_empty() {
        true => reason,
        false => format!("{reason} ({})", left_out.join(", ")),
    })?;
    Ok(FittedChart { fit, map, order, left_out })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colour_chart::test_chart::{self, CORNERS};
    use relume_compare::largest_difference;

    /// A camera with a colour cast and some mixing of channels.
    const CAMERA: DMat3 = DMat3::from_cols(
        DVec3::new(0.70, 0.10, 0.03),
        DVec3::new(0.12, 0.55, 0.08),
        DVec3::new(0.08, 0.06, 0.30),
    );
    const EDITION: ChartEdition = ChartEdition::SinceNovember2014;

    fn photograph(camera: DMat3) -> ImageRgba {
        test_chart::photograph(CORNERS, |index| camera * reflectances(EDITION)[index])
    }

    fn found(photograph: &ImageRgba, corners: [DVec2; 4]) -> Result<FittedChart, String> {
        fit_chart(photograph, DisplayRange::Unit, corners, EDITION)
    }

    #[test]
    fn matrix_and_exposure_are_recovered_from_a_photograph() {
        let off = |chart: &FittedChart, camera: DMat3| {
            largest_difference(&chart.fit.to_reflectance.to_cols_array(), &camera.inverse().to_cols_array())
        };
        for exposure in [1.0, 0.5] {
            let camera = CAMERA * exposure;
            let chart = found(&photograph(camera), CORNERS).unwrap();
            assert!(off(&chart, camera) < 2e-3, "{:?}", chart.fit);
            assert!(off(&chart, CAMERA * 0.8) > 0.1, "the control: another exposure");
            assert!(off(&chart, (CAMERA * exposure).transpose()) > 0.1, "the control: another matrix");
            assert!(chart.fit.after.mean < 0.1 && chart.fit.before.mean > 5.0, "{:?}", chart.fit);
            assert!(!chart.is_reordered() && chart.left_out.is_empty(), "{chart:?}");
        }
    }

    #[test]
    fn turned_and_mirrored_corners_are_recognised() {
        let photograph = photograph(CAMERA);
        for order in ORDERS {
            let mut given = [DVec2::ZERO; 4];
            (0..4).for_each(|i| given[order[i]] = CORNERS[i]);
            let chart = found(&photograph, given).unwrap();
            assert_eq!(chart.order, order);
            assert!(chart.fit.after.mean < 0.1);
            assert_eq!(chart.is_reordered(), order != [0, 1, 2, 3]);
        }
    }

    #[test]
    fn corners_of_something_else_are_refused_with_what_to_check() {
        let photograph = photograph(CAMERA);
        let moved = CORNERS.map(|corner| corner + DVec2::new(17.0, 9.0));
        let error = found(&photograph, moved).unwrap_err();
        assert!(error.contains("dark skin, bluish green") && error.contains("stored"), "{error}");
        let near = CORNERS.map(|corner| corner + DVec2::new(1.0, -1.0));
        assert!(found(&photograph, near).unwrap().fit.after.mean < 0.5, "the control");
        let clipped = test_chart::photograph(CORNERS, |index| 8.0 * CAMERA * reflectances(EDITION)[index]);
        let error = found(&clipped, CORNERS).unwrap_err();
        assert!(error.contains("at least 12") && error.contains("white: clipped"), "{error}");
    }

    #[test]
    fn wrong_fits_are_far_above_the_limit() {
        let photograph = photograph(CAMERA);
        for order in &ORDERS[1..] {
            let wrong = fit_in_order(&photograph, DisplayRange::Unit, CORNERS, EDITION, *order).unwrap();
            assert!(wrong.fit.after.mean > 1.3 * MAX_MEAN, "{order:?}: {:?}", wrong.fit.after);
        }
    }
}
