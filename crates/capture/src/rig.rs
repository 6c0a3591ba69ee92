//! Checks whether the poses of a capture are plausible. Most faults of poses have numbers that no real capture has: cameras that
//! look away from what they photograph, one pose for all, one camera far from the others, the sky at the side.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat4, DVec3};

use crate::CaptureError;
use crate::bounds::nearest_to_axes;
use crate::error::name_list;
use crate::photos::{PhotoEntry, Split};

/// Largest difference of two equal poses, relative to the size of the numbers.
const SAME: f64 = 1e-6;
/// A camera is stray if its distance from the middle of the cameras is this many times the median distance.
const STRAY: f64 = 20.0;
/// Least number of cameras among which one can be stray.
const STRAY_CAMERAS: usize = 8;
/// Least cosine between +Z and the mean up direction of the cameras, 60 degrees.
const UPRIGHT: f64 = 0.5;

/// Warns of implausible poses.
///
/// # Errors
/// Names the file that gives all photographs one pose.
pub(super) fn check(photos: &[PhotoEntry], warnings: &mut Vec<String>) -> Result<(), CaptureError> {
    let Some(first) = photos.first() else { return Ok(()) };
    if photos.iter().all(|photo| is_same(&photo.pose, &first.pose)) {
        let reason = format!("gives all {} photographs the same pose", photos.len());
        return Err(CaptureError::File { file: first.stated_in.clone(), reason });
    }
    warnings.extend(stray_cameras(photos));
    warnings.extend(looking_away(photos));
    warnings.extend(up(photos));
    Ok(())
}

fn is_same(a: &DMat4, b: &DMat4) -> bool {
    let size = a.to_cols_array().iter().fold(1.0f64, |most, v| most.max(v.abs()));
    a.abs_diff_eq(*b, SAME * size)
}

/// Keeps one of the frames that name one photograph with the same pose: a held-out one, so that no held-out photograph is trained
/// on, else the first.
///
/// # Errors
/// Names the frame that gives a photograph a second pose.
pub(super) fn remove_repeated(
    photos: &mut Vec<PhotoEntry>,
    warnings: &mut Vec<String>,
) -> Result<(), CaptureError> {
    let mut kept: BTreeMap<String, usize> = BTreeMap::new();
    let mut repeated = Vec::new();
    for (i, photo) in photos.iter().enumerate() {
        let Some(earlier) = kept.get_mut(&photo.image) else {
            kept.insert(photo.image.clone(), i);
            continue;
        };
        let first = &photos[*earlier];
        if !is_same(&first.pose, &photo.pose) {
            let reason = format!("names {}, which {} names with another pose", photo.image, first.field);
            return Err(CaptureError::at_field(&photo.stated_in, photo.field.clone(), reason));
        }
        if photo.split == Split::Test && first.split == Split::Train {
            *earlier = i;
        }
        repeated.push(photo.image.clone());
    }
    if !repeated.is_empty() {
        let kept: BTreeSet<usize> = kept.into_values().collect();
        let all = std::mem::take(photos).into_iter().enumerate();
        *photos = all.filter(|(i, _)| kept.contains(i)).map(|(_, photo)| photo).collect();
        warnings.push(format!(
            "{} photographs are named more than once and are used once, held out if one of the frames is: {}",
            repeated.len(),
            name_list(&repeated)
        ));
    }
    Ok(())
}

fn eye(photo: &PhotoEntry) -> DVec3 {
    photo.pose.w_axis.truncate()
}

/// The indices of points that lie far from all others.
pub(super) fn strays(points: &[DVec3]) -> Vec<usize> {
    if points.len() < STRAY_CAMERAS {
        return Vec::new();
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let middle = DVec3::from_array([0, 1, 2].map(|axis| median(points.iter().map(|p| p[axis]).collect())));
    let distances: Vec<f64> = points.iter().map(|p| (*p - middle).length()).collect();
    let usual = median(distances.clone());
    let is_stray = |i: &usize| distances[*i] > STRAY * usual && usual > 0.0;
    (0..points.len()).filter(is_stray).collect()
}

fn stray_cameras(photos: &[PhotoEntry]) -> Option<String> {
    let strays = strays(&photos.iter().map(eye).collect::<Vec<_>>());
    let names: Vec<String> = strays.iter().map(|i| photos[*i].image.clone()).collect();
    (!names.is_empty()).then(|| {
        let (count, names) = (names.len(), name_list(&names));
        format!("{count} cameras are more than {STRAY} times as far away as the others; check their poses: {names}")
    })
}

fn looking_away(photos: &[PhotoEntry]) -> Option<String> {
    let axes = |photo: &PhotoEntry| (eye(photo), -photo.pose.z_axis.truncate().normalize_or_zero());
    let centre = nearest_to_axes(photos.iter().map(axes));
    let sees = |photo: &&PhotoEntry| {
        let (eye, forward) = axes(photo);
        forward.dot(centre - eye) > 0.0
    };
    let looking = photos.iter().filter(sees).count();
    (2 * looking < photos.len()).then(|| {
        format!(
            "only {looking} of {} cameras look towards the point at which all look: the poses may have OpenCV axes (y down, z \
             forward) instead of OpenGL axes, or be world-to-camera; for a room that is seen from its inside this is normal",
            photos.len()
        )
    })
}

fn up(photos: &[PhotoEntry]) -> Option<String> {
    let ups = photos.iter().map(|photo| photo.pose.y_axis.truncate().normalize_or_zero());
    let mean = ups.sum::<DVec3>() / photos.len().max(1) as f64;
    let is_common = mean.length() > 0.5;
    (is_common && mean.normalize().z < UPRIGHT).then(|| {
        format!(
            "the mean up direction of the cameras is ({:.2}, {:.2}, {:.2}), not +Z: environment maps will shine from the side; \
             rotate the poses so that +Z is up",
            mean.x, mean.y, mean.z
        )
    })
}
