//! The world point on the surface that a pixel sees.

use crate::cpu::occluder::{Vec3, dot};
use crate::cpu::pass::Pass;
use crate::cpu::project::{Splat, normalise};
use relume_layout::channel;
use relume_layout::constants::{ALPHA_MAX, LIFT, MAX_MEAN_DEPTH_ERROR, MAX_PLANE_DEPTH_ERROR, TILE};

/// The world point that pixel (`x`, `y`) of a pass with normals sees, on the plane of the Gaussian at which coverage reaches
/// half of the pixel's. At an edge the mean depth lies between two surfaces; this point lies on one of them. For an empty
/// pixel it is the camera's centre.
pub fn surface_point(pass: &Pass, x: usize, y: usize) -> [f32; 3] {
    let (ray, depth) = (pass.view.ray(x, y), surface_depth(pass, x, y));
    std::array::from_fn(|k| pass.view.centre[k] + depth * ray[k])
}

/// World points for the offsets `places` within pixel (`x`, `y`), pixels from its centre: on the pixel's mean plane, slightly
/// in front of it. The mean plane is smoother than the planes of single Gaussians. Where it is not near [`surface_point`], all
/// points have the depth of [`surface_point`].
pub fn surface_points<const N: usize>(
    pass: &Pass,
    (x, y): (usize, usize),
    places: [[f32; 2]; N],
) -> [[f32; 3]; N] {
    let seen = surface_depth(pass, x, y);
    let blended: Vec3 = std::array::from_fn(|k| pass.at(x, y, channel::NORMAL.start + k));
    let distance = pass.at(x, y, channel::PLANE);
    let (normal, _) = normalise(blended);
    let to_camera = if dot(normal, pass.view.ray(x, y)) > 0.0 { -LIFT } else { LIFT };
    places.map(|[dx, dy]| {
        let ray = pass.view.ray_through([x as f32 + 0.5 + dx, y as f32 + 0.5 + dy]);
        let mean = distance / dot(blended, ray);
        // NaN and infinity fail the test.
        let depth = if (mean - seen).abs() <= MAX_MEAN_DEPTH_ERROR * seen { mean } else { seen };
        std::array::from_fn(|k| pass.view.centre[k] + depth * ray[k] + to_camera * normal[k])
    })
}

/// Camera depth of [`surface_point`].
fn surface_depth(pass: &Pass, x: usize, y: usize) -> f32 {
    let half = 1.0 - 0.5 * pass.at(x, y, channel::COVERAGE);
    let ray = pass.view.ray(x, y);
    let mut left = 1.0f32;
    let mut depth = 0.0;
    for index in pass.tiles.members(y / TILE * pass.tiles.columns + x / TILE) {
        let splat = &pass.splats[*index as usize];
        let alpha = alpha(splat, x, y);
        if alpha > 0.0 {
            left *= 1.0 - alpha;
            depth = depth_on_plane(pass, *index as usize, splat.depth, ray);
        }
        if left <= half {
            break;
        }
    }
    depth
}

/// Alpha of `splat` at the centre of pixel (`x`, `y`).
fn alpha(splat: &Splat, x: usize, y: usize) -> f32 {
    let (dx, dy) = (x as f32 + 0.5 - splat.mean[0], y as f32 + 0.5 - splat.mean[1]);
    let [xx, xy, yy] = splat.conic;
    let power = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy;
    if power <= splat.reach { (splat.opacity * (-power).exp()).min(ALPHA_MAX) } else { 0.0 }
}

/// Depth at which `ray` meets the plane of a Gaussian, or its centre's depth where the plane is seen edge-on.
fn depth_on_plane(pass: &Pass, splat: usize, centre: f32, ray: [f32; 3]) -> f32 {
    let row = &pass.attributes[splat * pass.channels.stored()..];
    let along: f32 = (0..3).map(|k| row[channel::NORMAL.start + k] * ray[k]).sum();
    let depth = row[channel::PLANE] / along;
    // NaN and infinity count as edge-on.
    if (depth - centre).abs() <= MAX_PLANE_DEPTH_ERROR * centre { depth } else { centre }
}
