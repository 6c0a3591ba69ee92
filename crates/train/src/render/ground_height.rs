//! The height of the ground below a model.

use glam::{DQuat, DVec3};

use crate::render::{Renderer, Turntable};
use relume_scene::{Field, Gaussians};

/// Views around the model from which the lowest visible point is found: their number, elevation in degrees, and side in pixels.
const VIEWS: u32 = 12;
const ELEVATION_DEG: f64 = 10.0;
const SIDE: u32 = 128;
/// Coverage from which a pixel shows the surface alone.
const MIN_COVERAGE: f32 = 0.9;
/// Share of the visible points that may lie below the ground.
const BELOW: f64 = 0.0005;
/// Distance from the origin up to which points count, normalised world: the surroundings of a subject without masks do not.
const REACH: f32 = 4.0;
/// Least opacity of a Gaussian that counts, standard deviations to the edge that it shows, and share of the Gaussians that may lie below the
/// ground by their opacity.
const MIN_OPACITY: f64 = 0.5;
const EDGE: f64 = 1.5;
const GAUSSIANS_BELOW: f64 = 0.002;
/// Height if nothing is visible, normalised world.
const LOWEST: f64 = -1.0;

impl Renderer {
    /// Height of the ground, capture units: the lowest point that views around the model show, and not below the edges of nearly all opaque
    /// Gaussians. Gaussians that hang below a surface, where no photograph saw them, do not count. Found once per renderer.
    pub fn ground_height(&self) -> f64 {
        *self.ground.get_or_init(|| {
            let model = self.model();
            // A pixel has the depth of the centres of its Gaussians, which lets large ones appear too low.
            let edge = lowest_edge(&model.gaussians).unwrap_or(f64::NEG_INFINITY);
            let lowest = lowest_visible(self).map_or(LOWEST, |visible| visible.max(edge));
            lowest / model.world_scale - model.world_offset.z
        })
    }

    /// `height` in the normalised world; `None`: [`Self::ground_height`].
    pub(super) fn normalised_height(&self, height: Option<f64>) -> f32 {
        let model = self.model();
        ((height.unwrap_or_else(|| self.ground_height()) + model.world_offset.z) * model.world_scale) as f32
    }
}

/// The lowest visible height, normalised world; `None` if nothing is visible.
fn lowest_visible(renderer: &Renderer) -> Option<f64> {
    let ring = Turntable {
        frames: VIEWS,
        azimuth_deg: None,
        elevation_deg: Some(ELEVATION_DEG),
        camera_turn_deg: 360.0,
        size: (SIDE, SIDE),
    };
    let mut heights = Vec::new();
    for view in ring.views(renderer.model()).ok()? {
        let surfaces = renderer.host().surfaces(renderer.view(&view.camera).ok()?);
        let counts = |p: &[f32; 3]| p.iter().map(|v| v * v).sum::<f32>() < REACH * REACH;
        let shown = surfaces.iter().filter(|s| s.coverage > MIN_COVERAGE && counts(&s.position));
        heights.extend(shown.map(|s| s.position[2]));
    }
    let below = (heights.len() as f64 * BELOW) as usize;
    let (_, lowest, _) =
        heights.get(below).is_some().then(|| heights.select_nth_unstable_by(below, f32::total_cmp))?;
    Some(f64::from(*lowest))
}

/// The height below which few opaque Gaussians reach, normalised world; `None` if there are none.
fn lowest_edge(g: &Gaussians) -> Option<f64> {
    let edge = |i: usize| {
        let opacity = 1.0 / (1.0 + (-f64::from(g.row(Field::OpacityLogit, i)[0])).exp());
        let mean = DVec3::from_array(g.get::<3>(Field::Mean, i).map(f64::from));
        let counts = g.is_photographed(i) && opacity >= MIN_OPACITY && mean.length() < f64::from(REACH);
        counts.then(|| (mean.z - EDGE * vertical_deviation(g, i), opacity))
    };
    let mut edges: Vec<(f64, f64)> = (0..g.len()).filter_map(edge).collect();
    edges.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let wanted = GAUSSIANS_BELOW * edges.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let reached = edges.iter().find(|(_, weight)| {
        sum += weight;
        sum >= wanted
    });
    reached.map(|(height, _)| *height)
}

/// Standard deviation of a Gaussian along z.
fn vertical_deviation(g: &Gaussians, i: usize) -> f64 {
    let [w, x, y, z] = g.get::<4>(Field::Quaternion, i).map(f64::from);
    let turn = DQuat::from_xyzw(x, y, z, w);
    let up = if turn.length_squared() > 0.0 { turn.normalize().inverse() * DVec3::Z } else { DVec3::Z };
    let scales = DVec3::from_array(g.get::<3>(Field::LogScale, i).map(|s| f64::from(s).exp()));
    (up * scales).length()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use relume_scene::{Field, Gaussians, Model};

    /// A flat square of small Gaussians around the origin at `height`, and a ball of a height and radius.
    fn renderer(height: f32, ball: Option<(f32, f32)>) -> Renderer {
        let (low, radius) = ball.unwrap_or((height, 0.01));
        let count = 21 * 21;
        let mut g = Gaussians::zeroed(count + 1, 1, 0, 0);
        for i in 0..count {
            let [x, y] = [i % 21, i / 21].map(|k| 0.05 * (k as f32 - 10.0));
            g.row_mut(Field::Mean, i).copy_from_slice(&[x, y, height]);
            g.row_mut(Field::LogScale, i).copy_from_slice(&[0.03f32.ln(), 0.03f32.ln(), 0.005f32.ln()]);
        }
        g.row_mut(Field::Mean, count).copy_from_slice(&[0.0, 0.0, low]);
        g.row_mut(Field::LogScale, count).fill(radius.ln());
        for i in 0..=count {
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::OpacityLogit, i)[0] = 9.0;
        }
        let mut model = Model::new(g, vec![[0.5; 3]], vec![[0.5; 3]; 8], (4, 2));
        (model.world_scale, model.world_offset) = (0.5, glam::DVec3::new(0.0, 0.0, 3.0));
        Renderer::new(Arc::new(model))
    }

    #[test]
    fn ground_is_at_the_lowest_visible_point() {
        // Heights of the normalised world.
        let of = |height, ball| 0.5 * (renderer(height, ball).ground_height() + 3.0);
        let (plain, lower) = (of(0.2, None), of(-0.4, None));
        assert!((plain - 0.2).abs() < 0.03 && (lower + 0.4).abs() < 0.03, "{plain} {lower}");
        let hidden = of(0.2, Some((0.14, 0.02)));
        assert!((hidden - 0.2).abs() < 0.03, "the square hides the ball: {hidden}");
        let visible = of(0.2, Some((-0.6, 0.08)));
        assert!(visible < -0.5, "the ball is visible below the square: {visible}");
    }

    #[test]
    fn model_without_a_surface_has_a_ground() {
        let empty = Model::new(Gaussians::zeroed(0, 1, 0, 0), vec![[0.5; 3]], vec![[0.5; 3]; 8], (4, 2));
        assert_eq!(Renderer::new(Arc::new(empty)).ground_height(), LOWEST);
    }
}
