//! The position and size of what the opaque Gaussians of a model show.

use glam::DVec3;

use crate::{Field, Gaussians};

/// Least opacity of a Gaussian that counts.
const MIN_OPACITY: f64 = 0.5;
/// Greatest standard deviation of a Gaussian that counts, radii of the ball. Larger ones are haze, which represents the surroundings.
const MAX_SCALE: f64 = 0.2;
/// Least number of Gaussians that show something.
const MIN_GAUSSIANS: usize = 16;
/// Share of the surface that may lie outside on each side: floaters.
const OUTLIERS: f64 = 0.005;

/// The middle of the opaque Gaussians whose means lie in a ball, in the units of the Gaussians. Each counts with its opacity times
/// the area of its broadest side; large Gaussians are haze. `None` if there are too few.
pub fn opaque_centre(g: &Gaussians, centre: DVec3, radius: f64) -> Option<DVec3> {
    let surface = surface(g, centre, radius)?;
    let middle = |k: usize| {
        let mut along: Vec<(f64, f64)> = surface.iter().map(|(p, weight)| (p[k], *weight)).collect();
        let ends = [OUTLIERS, 1.0 - OUTLIERS].map(|q| quantile(&mut along, q));
        0.5 * (ends[0] + ends[1])
    };
    Some(DVec3::new(middle(0), middle(1), middle(2)))
}

/// The radius around `centre` that contains the opaque Gaussians in a ball, at most that of the ball. They count as in
/// [`opaque_centre`]. `None` if there are too few.
pub fn opaque_radius(g: &Gaussians, centre: DVec3, radius: f64) -> Option<f64> {
    let surface = surface(g, centre, radius)?;
    let mut distances: Vec<(f64, f64)> = surface.iter().map(|(p, w)| ((*p - centre).length(), *w)).collect();
    let reach = quantile(&mut distances, 1.0 - OUTLIERS);
    (reach > 0.0).then_some(reach)
}

/// Means and weights of the opaque Gaussians in the ball.
fn surface(g: &Gaussians, centre: DVec3, radius: f64) -> Option<Vec<(DVec3, f64)>> {
    let surface: Vec<_> = counting(g, centre, radius).collect();
    (surface.len() >= MIN_GAUSSIANS).then_some(surface)
}

/// Means and weights of the opaque Gaussians in the ball.
fn counting(g: &Gaussians, centre: DVec3, radius: f64) -> impl Iterator<Item = (DVec3, f64)> {
    (0..g.len()).filter_map(move |i| {
        let mean = DVec3::from_array(g.get::<3>(Field::Mean, i).map(f64::from));
        let opacity = 1.0 / (1.0 + (-f64::from(g.row(Field::OpacityLogit, i)[0])).exp());
        let mut scales = g.get::<3>(Field::LogScale, i).map(|s| f64::from(s).exp());
        scales.sort_by(f64::total_cmp);
        let counts = opacity >= MIN_OPACITY
            && scales[2] < MAX_SCALE * radius
            && (mean - centre).length() < radius
            && scales[1] > 0.0;
        counts.then_some((mean, opacity * scales[1] * scales[2]))
    })
}

/// The least value such that the share `q` of the weight lies at it or below; sorts `values`, which must not be empty.
fn quantile(values: &mut [(f64, f64)], q: f64) -> f64 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let wanted = q * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let reached = values.iter().find(|(_, weight)| {
        sum += weight;
        sum >= wanted
    });
    reached.or(values.last()).map_or(0.0, |(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sphere of 400 small opaque Gaussians, and `others`: mean, opacity logit and log-scale.
    fn sphere(centre: DVec3, radius: f64, others: &[([f32; 3], f32, f32)]) -> Gaussians {
        let mut g = Gaussians::zeroed(400 + others.len(), 1, 0, 0);
        for i in 0..400 {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / 400.0;
            let (sin, cos) = (2.399_963 * i as f64).sin_cos();
            let ring = (1.0 - z * z).sqrt();
            let p = centre + radius * DVec3::new(ring * cos, ring * sin, z);
            g.row_mut(Field::Mean, i).copy_from_slice(&p.as_vec3().to_array());
            g.row_mut(Field::OpacityLogit, i)[0] = 3.0;
            g.row_mut(Field::LogScale, i).fill(-4.0);
        }
        for (k, (mean, logit, scale)) in others.iter().enumerate() {
            g.row_mut(Field::Mean, 400 + k).copy_from_slice(mean);
            g.row_mut(Field::OpacityLogit, 400 + k)[0] = *logit;
            g.row_mut(Field::LogScale, 400 + k).fill(*scale);
        }
        g
    }

    #[test]
    fn extent_is_that_of_the_surface_without_haze_and_floaters() {
        let at = DVec3::new(0.3, -0.1, 0.2);
        let others =
            [([-0.9, 0.0, 0.0], 3.0, 0.0), ([0.0, 0.9, 0.0], -1.0, -2.0), ([0.0, 0.0, -0.9], 3.0, -4.5)];
        let g = sphere(at, 0.4, &others);
        let centre = opaque_centre(&g, DVec3::ZERO, 1.0).unwrap();
        assert!((centre - at).length() < 0.02, "{centre}");
        let radius = opaque_radius(&g, at, 1.0).unwrap();
        assert!((radius - 0.4).abs() < 0.01, "{radius}");
        let large = opaque_radius(&sphere(at, 0.7, &[]), at, 1.0).unwrap();
        assert!((large - 0.7).abs() < 0.01, "the control: {large}");
    }

    #[test]
    fn too_few_gaussians_have_no_extent() {
        let g = sphere(DVec3::ZERO, 0.4, &[]);
        assert!(opaque_radius(&g, DVec3::ZERO, 1.0).is_some(), "the control");
        assert_eq!(opaque_centre(&g, DVec3::X * 5.0, 1.0), None, "none in the ball");
        assert_eq!(opaque_radius(&g, DVec3::ZERO, 0.1), None);
        assert_eq!(opaque_radius(&Gaussians::zeroed(0, 1, 0, 0), DVec3::ZERO, 1.0), None);
    }
}
