//! Measures the chart in a photograph of a capture.

use std::path::Path;

use glam::DVec2;

use crate::colour_chart::delta_e::DeltaE;
use crate::colour_chart::matrix::ColourMatrix;
use crate::colour_chart::order::{FittedChart, fit_chart};
use crate::colour_chart::reference::{FIRST_NEUTRAL, NAMES, PATCHES, reflectances};
use crate::colour_chart::sampling::corners_of_patch;
use crate::images::{Loaded, load_photo};
use crate::light_rotations::{NO_SUCH_PHOTO, SEVERAL_PHOTOS, is_named};
use crate::patch::camera_of_part;
use crate::photos::PhotoEntry;
use crate::{CaptureError, CaptureFiles, ImportLimits, ImportOptions, Up, import};
use relume_scene::Camera;
use relume_spec::training::ColourChart;

/// Greatest width and height of the picture of a patch, pixels.
const PATCH_SIDE: f64 = 16.0;

/// A patch of a chart in the world of the capture.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartPatch {
    /// Its name, such as `dark skin`.
    pub name: &'static str,
    /// Its reflectance, linear Rec.709. One patch, cyan, has a negative channel.
    pub reflectance: [f32; 3],
    /// True for the six patches from white to black.
    pub is_neutral: bool,
    /// The camera that sees only the middle of the patch, at most 16 pixels wide and high. `None` if the lens shows nothing there without
    /// its distortion.
    pub camera: Option<Camera>,
}

/// A chart in a photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredChart {
    /// The matrix for all photographs. It keeps the brightest channel of a neutral surface in the light of the chart.
    pub matrix: ColourMatrix,
    /// Differences of the patches from their reference with the best exposure alone.
    pub before: DeltaE,
    /// Differences with the best matrix.
    pub after: DeltaE,
    /// Patches that were not used for the matrix, with the reason.
    pub left_out: Vec<String>,
    /// Positions of the corners at dark skin, bluish green, black and white in the given list, 1 to 4.
    pub order: [usize; 4],
    /// States the right order, if the corners were given in another one.
    pub warning: Option<String>,
    /// The 24 patches, row by row.
    pub patches: Vec<ChartPatch>,
}

/// Measures `chart` in the capture at `path`, a folder or an archive. The photograph is read as it is stored: at its own size, with its lens
/// distortion, without a mask file, and with its colours converted to sRGB as for a training. The cameras of the patches are in the world of
/// the up direction `up`.
///
/// # Errors
/// [`CaptureError::Field`] with a name that fits no photograph or several (`colour_chart.photo`), or with corners where there is no chart
/// (`colour_chart.corners`), otherwise as [`crate::cameras`].
pub fn measure_colour_chart(
    path: &Path,
    limits: &ImportLimits,
    up: impl Into<Up>,
    chart: &ColourChart,
) -> Result<MeasuredChart, CaptureError> {
    let refused = |field: &str, reason: String| {
        CaptureError::at_field(&chart.photo, format!("colour_chart.{field}"), reason)
    };
    let source = CaptureFiles::open(path, limits)?;
    let layout = import::read_layout(&source, up.into(), &mut Vec::new())?;
    let mut named = layout.photos.iter().filter(|photo| is_named(&photo.image, &chart.photo));
    let photo = named.next().ok_or_else(|| refused("photo", NO_SUCH_PHOTO.to_owned()))?;
    if named.next().is_some() {
        return Err(refused("photo", SEVERAL_PHOTOS.to_owned()));
    }
    let options = ImportOptions { limits: *limits, ..ImportOptions::default() };
    let Loaded { image, stored, light, .. } =
        load_photo(&source, &photo.image, photo.lens.approximate_size(), &options)?;
    let size = [f64::from(stored.0), f64::from(stored.1)];
    if !chart.corners.iter().all(|[x, y]| (0.0..=size[0]).contains(x) && (0.0..=size[1]).contains(y)) {
        let reason = format!("must lie within the photograph of {} x {} pixels", stored.0, stored.1);
        return Err(refused("corners", reason));
    }
    let corners = chart.corners.map(DVec2::from);
    let fitted =
        fit_chart(&image, light.range, corners, chart.edition).map_err(|why| refused("corners", why))?;
    let matrix = fitted.fit.applied().map_err(|reason| refused("corners", reason))?;
    Ok(MeasuredChart {
        matrix: ColourMatrix::of(matrix),
        before: fitted.fit.before,
        after: fitted.fit.after,
        order: fitted.order.map(|i| i + 1),
        warning: fitted.is_reordered().then(|| reordered(chart, &fitted)),
        patches: patches(photo, stored, chart, &fitted)?,
        left_out: fitted.left_out,
    })
}

/// The warning of corners in another order.
fn reordered(chart: &ColourChart, fitted: &FittedChart) -> String {
    let order = fitted.order.map(|i| (i + 1).to_string()).join(", ");
    let corners = fitted.order.map(|i| chart.corners[i].map(|v| v.to_string()).join(",")).join(",");
    format!(
        "{photo}: colour_chart.corners: the colours show the chart in the order {order}, which is used; from dark skin clockwise it is \
         {photo}:{corners}",
        photo = chart.photo
    )
}

fn patches(
    photo: &PhotoEntry,
    stored: (u32, u32),
    chart: &ColourChart,
    fitted: &FittedChart,
) -> Result<Vec<ChartPatch>, CaptureError> {
    let reflectances = reflectances(chart.edition);
    let patch = |index: usize| {
        let corners = corners_of_patch(&fitted.map, index);
        Ok(ChartPatch {
            name: NAMES[index],
            reflectance: reflectances[index].as_vec3().to_array(),
            is_neutral: index >= FIRST_NEUTRAL,
            camera: camera_of_part(photo, stored, corners, PATCH_SIDE)?,
        })
    };
    (0..PATCHES).map(patch).collect()
}
