//! Checks whether the poses of a capture are plausible. It finds cameras that look away from the object, one pose for all
//! photographs, a camera far from the others, and cameras that are upside down.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat4, DVec3};

use crate::CaptureError;
use crate::bounds::{Axes, nearest_to_axes};
use crate::error::name_list;
use crate::formats::ply_points::Point;
use crate::photos::{PhotoEntry, Split};

/// Largest difference of two equal poses, relative to the size of the numbers.
const SAME: f64 = 1e-6;
/// A camera is stray if its distance from the middle of the cameras is this many times the median distance.
const STRAY: f64 = 20.0;
/// Least number of cameras among which one can be stray.
const STRAY_CAMERAS: usize = 8;

/// Half the angle of a cone that every camera sees, degrees, and the least share of a point cloud that a camera sees in it.
const SEEN: (f64, f64) = (25.0, 0.01);
/// Mean squared sine of the angles between viewing directions and their mean, below which they are parallel.
const PARALLEL: f64 = 0.03;
/// Number of points that are looked at.
const POINTS: usize = 2000;
/// Fewest points that say whether cameras see them.
const MIN_POINTS: usize = 16;

/// Warns of implausible poses, and of points that do not belong to them.
///
/// # Errors
/// Names the file that gives all photographs one pose.
pub(super) fn check(
    photos: &[PhotoEntry],
    points: &[Point],
    warnings: &mut Vec<String>,
) -> Result<(), CaptureError> {
    let Some(first) = photos.first() else { return Ok(()) };
    if photos.iter().all(|photo| is_same(&photo.pose, &first.pose)) {
        let reason = format!("gives all {} photographs the same pose", photos.len());
        return Err(CaptureError::File { file: first.stated_in.clone(), reason });
    }
    warnings.extend(stray_cameras(photos));
    warnings.extend(looking_away(photos));
    warnings.extend(upside_down(photos));
    warnings.extend(unseen_points(photos, points));
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
            "photographs that are named more than once: {}; each is used once, held out if one of the frames is: {}",
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
        format!(
            "cameras more than {STRAY} times as far away as the others: {count}; check their poses: {names}"
        )
    })
}

/// Position and viewing direction of a camera.
fn axis(pose: &DMat4) -> (DVec3, DVec3) {
    (pose.w_axis.truncate(), -pose.z_axis.truncate().normalize_or_zero())
}

/// How many cameras look towards the point at which all look.
pub(super) fn looking(poses: &[DMat4]) -> usize {
    let centre = nearest_to_axes(poses.iter().map(axis));
    let sees = |pose: &&DMat4| {
        let (eye, forward) = axis(pose);
        forward.dot(centre - eye) > 0.0
    };
    poses.iter().filter(sees).count()
}

/// How many cameras have the point at which all look in the cone of [`SEEN`], farther away than a rounding error. 0 if the axes are
/// too parallel to determine a point.
pub(super) fn looking_straight(poses: &[DMat4]) -> usize {
    let axes = Axes::of(poses.iter().map(axis));
    // Also true for numbers that are not finite.
    if !(axes.spread() > PARALLEL) {
        return 0;
    }
    let centre = axes.nearest_point();
    let sees = |pose: &&DMat4| {
        let (eye, forward) = axis(pose);
        let away = centre - eye;
        away.length() > SAME * eye.length().max(1e-300) && is_in_cone(away, forward)
    };
    poses.iter().filter(sees).count()
}

fn is_in_cone(towards: DVec3, forward: DVec3) -> bool {
    towards.normalize_or_zero().dot(forward) > SEEN.0.to_radians().cos()
}

fn looking_away(photos: &[PhotoEntry]) -> Option<String> {
    let looking = looking(&photos.iter().map(|photo| photo.pose).collect::<Vec<_>>());
    (2 * looking < photos.len()).then(|| {
        format!(
            "only {looking} of {} cameras look towards the point at which all look: the poses may be world-to-camera instead of \
             camera-to-world, which inverted matrices correct; for a room that is seen from its inside this is normal, and without \
             points its size is a guess",
            photos.len()
        )
    })
}

/// The up direction of a camera.
fn up(photo: &PhotoEntry) -> DVec3 {
    photo.pose.y_axis.truncate().normalize_or_zero()
}

fn upside_down(photos: &[PhotoEntry]) -> Option<String> {
    let mean = photos.iter().map(up).sum::<DVec3>() / photos.len().max(1) as f64;
    if mean.length() < 0.5 {
        return None;
    }
    let turned = photos.iter().filter(|photo| up(photo).dot(mean.normalize()) < -0.5);
    let names: Vec<String> = turned.map(|photo| photo.image.clone()).collect();
    (!names.is_empty()).then(|| {
        format!(
            "cameras that are upside down compared with the others: {}; check whether their photographs were rotated: {}",
            names.len(),
            name_list(&names)
        )
    })
}

/// How many cameras see the points: at least the share of [`SEEN`] in its cone. `None` for fewer than [`MIN_POINTS`].
pub(super) fn seeing(poses: &[DMat4], points: &[Point]) -> Option<usize> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let points: Vec<DVec3> =
        points.iter().step_by(points.len().div_ceil(POINTS).max(1)).map(|p| p.0).collect();
    let sees = |pose: &&DMat4| {
        let (eye, forward) = axis(pose);
        let seen = points.iter().filter(|point| is_in_cone(**point - eye, forward)).count();
        seen as f64 >= SEEN.1 * points.len() as f64
    };
    Some(poses.iter().filter(sees).count())
}

fn unseen_points(photos: &[PhotoEntry], points: &[Point]) -> Option<String> {
    let seeing = seeing(&photos.iter().map(|photo| photo.pose).collect::<Vec<_>>(), points)?;
    (2 * seeing < photos.len()).then(|| {
        format!(
            "only {seeing} of {} cameras see the point cloud: its points may have other axes or units than the cameras",
            photos.len()
        )
    })
}
