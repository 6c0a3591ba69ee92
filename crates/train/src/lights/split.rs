//! Divides a learned environment between lights and the rest.

use std::f32::consts::PI;

use glam::DVec3;

use crate::lights::detected_light::DetectedLight;
use relume_engine::upward_share;
use relume_scene::{LightSplit, MAX_LIGHTS, Model, SplitLight, softplus, softplus_inverse, texel_directions};

/// Greatest angle between a texel and the edge of the light to which it belongs, radians: a learned light is blurred.
pub(super) const REACH: f64 = 0.26;

/// Divides an environment of `width` x `height` texels between `lights` and the rest. A texel near lights belongs to
/// the nearest.
pub fn split(lights: &[SplitLight], width: usize, height: usize) -> LightSplit {
    if lights.is_empty() {
        return LightSplit::default();
    }
    // A light has at least one texel.
    let reach = REACH.max(std::f64::consts::PI / height as f64);
    let share = |texel: DVec3| {
        let mut out = [0.0; MAX_LIGHTS];
        let angles =
            lights.iter().map(|l| texel.angle_between(DVec3::from_array(l.direction.map(f64::from))));
        let nearest = angles.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((k, angle)) = nearest
            && angle < reach + f64::from(lights[k].radius)
        {
            out[k] = 1.0;
        }
        out
    };
    let shares = texel_directions(width, height).into_iter().map(|(d, _)| share(d)).collect();
    LightSplit { lights: lights.to_vec(), shares }
}

/// Restarts the light of `model`: a uniform sky and the lights of `split` with their strengths. A surface that faces
/// up receives the same irradiance as before.
pub fn start(model: &mut Model, split: &LightSplit, found: &[DetectedLight]) {
    let texels = texel_directions(model.env_width, model.env_height);
    let mut up = [0.0f32; 3];
    for (raw, texel) in model.env_raw.iter().zip(&texels) {
        (0..3).for_each(|c| up[c] += upward_share(texel) * softplus(raw[c]));
    }
    let lit = |c: usize| found.iter().map(|f| f.strength[c] * f.light.direction[2].max(0.0)).sum::<f32>();
    let sky: [f32; 3] = std::array::from_fn(|c| up[c] / (1.0 + lit(c)));
    let mut areas = [0.0f32; MAX_LIGHTS];
    for (shares, (_, solid_angle)) in split.shares.iter().zip(&texels) {
        (0..MAX_LIGHTS).for_each(|k| areas[k] += shares[k] * *solid_angle as f32);
    }
    for (t, raw) in model.env_raw.iter_mut().enumerate() {
        let shares = split.shares.get(t).copied().unwrap_or_default();
        let lights = shares.iter().zip(&areas).zip(found);
        for c in 0..3 {
            let of_light = lights.clone().map(|((share, area), f)| share * f.strength[c] / area.max(1e-6));
            raw[c] = softplus_inverse(sky[c] * (split.rest(t) + PI * of_light.sum::<f32>()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::Gaussians;

    fn found(direction: [f32; 3], strength: f32) -> DetectedLight {
        DetectedLight { light: SplitLight { direction, radius: 0.005 }, strength: [strength; 3], gain: 0.1 }
    }

    #[test]
    fn split_light_covers_the_texels_around_it_and_at_least_one() {
        for (width, height) in [(32, 16), (8, 4)] {
            let lights = [[0.0, 0.6, 0.8], [0.6, 0.0, 0.8]].map(|d| found(d, 1.0).light);
            let split = split(&lights, width, height);
            assert_eq!(split.fault(width * height), None);
            for k in 0..2 {
                let share: f32 = split.shares.iter().map(|s| s[k]).sum();
                assert!((1.0..=16.0).contains(&share), "{width}: {share}");
            }
        }
        assert!(split(&[], 32, 16).is_empty());
    }

    #[test]
    fn split_start_sets_light_strength_and_keeps_the_level() {
        let mut model = Model::new(
            Gaussians::zeroed(1, 1, 0, 0),
            vec![[0.5; 3]],
            vec![[0.3, 0.0, -0.5]; 32 * 16],
            (32, 16),
        );
        let texels = texel_directions(32, 16);
        let up = |model: &Model| {
            let texels = model.env_raw.iter().zip(&texels);
            texels.map(|(raw, t)| upward_share(t) * softplus(raw[1])).sum::<f32>()
        };
        let before = up(&model);
        let sun = found([0.0, 0.6, 0.8], 4.0);
        let split = split(&[sun.light], 32, 16);
        start(&mut model, &split, &[sun]);
        assert!((up(&model) / before - 1.0).abs() < 0.05, "{} {before}", up(&model));
        let light: Vec<[f32; 3]> = model.env_raw.iter().map(|raw| raw.map(softplus)).collect();
        let sent: f32 = (0..512).map(|t| split.shares[t][0] * texels[t].1 as f32 * light[t][1]).sum();
        let sky = light[511][1];
        assert!((sent / (std::f32::consts::PI * sky) - 4.0).abs() < 0.05, "{sent} {sky}");
        start(&mut model, &LightSplit::default(), &[]);
        assert!((up(&model) / before - 1.0).abs() < 0.05, "without lights the result is a uniform sky");
        assert!(model.env_raw.iter().all(|raw| *raw == model.env_raw[0]));
    }
}
