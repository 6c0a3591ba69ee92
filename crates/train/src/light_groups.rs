//! Light groups: sets of photographs that share a light. Each group has an environment of its own; the materials are common.

use std::collections::BTreeSet;

use crate::dataset::Dataset;
use relume_capture::CaptureView;
use relume_engine::{PhotoSize, TrainState, linear_from_srgb};
use relume_scene::light::{LightColour, luminance};
use relume_scene::{Model, softplus, softplus_inverse};

/// Least mean of a channel of a group's photographs, linear: noise dominates the colour below it.
const MIN_MEAN: f32 = 1e-3;
/// Mask value above which a pixel shows only the object.
const MIN_FULL_MASK: f32 = 0.95;
/// Least radiance of a texel, the range of the softplus.
const MIN_RADIANCE: f32 = 1e-3;

/// Name of the group of the photographs that state none.
pub const DEFAULT_GROUP: &str = "";

/// Light of a group relative to the mean light of all photographs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelativeLight {
    /// Luminance, as a factor. The photographs of the group are divided by it, so that photographs of all groups have a similar brightness;
    /// [`restore_levels`] gives it back to the light.
    pub level: f32,
    /// Colour, as a difference.
    pub colour: LightColour,
}

impl Default for RelativeLight {
    /// The mean light.
    fn default() -> Self {
        Self { level: 1.0, colour: LightColour::NEUTRAL }
    }
}

impl RelativeLight {
    /// Colour of the group's light where the mean light has the colour `mean`.
    pub fn colour_of(&self, mean: LightColour) -> LightColour {
        LightColour {
            blue_over_red: mean.blue_over_red + self.colour.blue_over_red,
            green: mean.green + self.colour.green,
        }
    }

    /// Colour of the mean light where the light of the group has the colour `own`.
    pub fn mean_colour(&self, own: LightColour) -> LightColour {
        LightColour {
            blue_over_red: own.blue_over_red - self.colour.blue_over_red,
            green: own.green - self.colour.green,
        }
    }
}

/// Names of the light groups of `views`, in alphabetical order, and the index of each view's group.
pub fn groups(views: &[CaptureView]) -> (Vec<String>, Vec<usize>) {
    let name = |view: &CaptureView| view.light_group.clone().unwrap_or_else(|| DEFAULT_GROUP.to_owned());
    let names: Vec<String> = views.iter().map(name).collect::<BTreeSet<_>>().into_iter().collect();
    let index = |view| names.partition_point(|other| *other < name(view));
    let indices = views.iter().map(index).collect();
    (names, indices)
}

/// Light of each group by the mean linear colours of its photographs, because all photographs show the same materials. One group has
/// the mean light.
pub fn relative_lights(data: &Dataset) -> Vec<RelativeLight> {
    let groups = data.lights.groups();
    if groups == 1 {
        return vec![RelativeLight::default()];
    }
    let mut sums = vec![([0.0f64; 3], 0.0f64); groups];
    data.for_each_photo(PhotoSize::Half, |_, photo| {
        let (sum, weight) = &mut sums[photo.light.light.group];
        for (i, pixel) in photo.pixels.iter().enumerate() {
            // Other pixels of a masked photograph show the background.
            if photo.alpha.get(i).is_none_or(|alpha| *alpha > MIN_FULL_MASK) {
                (0..3).for_each(|c| sum[c] += f64::from(linear_from_srgb(pixel[c])));
                *weight += 1.0;
            }
        }
    });
    let mean = |(sum, weight): &([f64; 3], f64)| sum.map(|s| ((s / weight.max(1.0)) as f32).max(MIN_MEAN));
    let means: Vec<[f32; 3]> = sums.iter().map(mean).collect();
    let shares = data.lights.group_shares();
    let all: [f32; 3] = std::array::from_fn(|c| means.iter().zip(&shares).map(|(m, s)| m[c] * s).sum());
    let relative = |mean: &[f32; 3]| RelativeLight {
        level: luminance(*mean) / luminance(all),
        colour: LightColour::of(std::array::from_fn(|c| mean[c] / all[c])),
    };
    means.iter().map(relative).collect()
}

/// Multiplies the environment of each light group of `model` by the level by which its photographs were divided.
pub fn restore_levels(model: &mut Model, lights: &[RelativeLight]) {
    if lights.len() < 2 {
        return;
    }
    let texels = model.env_texels();
    for (environment, light) in model.env_raw.chunks_mut(texels.max(1)).zip(lights) {
        for raw in environment {
            *raw = raw.map(|v| softplus_inverse((softplus(v) * light.level).max(MIN_RADIANCE)));
        }
    }
}

/// Applies `change` to the mean light of the groups, whose photographs have the `shares`, then multiplies each group's light by the
/// factor by which the mean light changed, texel by texel. With one group this is `change` itself.
pub fn change_mean_light(state: &mut TrainState, shares: &[f32], change: impl FnOnce(&mut TrainState)) {
    if shares.len() < 2 {
        return change(state);
    }
    let texels = state.model.env_texels();
    let before = mean_radiance(&state.model, shares);
    let groups =
        std::mem::replace(&mut state.model.env_raw, before.iter().map(|t| t.map(softplus_inverse)).collect());
    change(state);
    let after: Vec<[f32; 3]> = state.model.env_raw.iter().map(|raw| raw.map(softplus)).collect();
    let changed = |(i, raw): (usize, &[f32; 3])| -> [f32; 3] {
        let t = i % texels;
        std::array::from_fn(|c| {
            let factor = after[t][c] / before[t][c].max(MIN_RADIANCE);
            softplus_inverse((softplus(raw[c]) * factor).max(MIN_RADIANCE))
        })
    };
    state.model.env_raw = groups.iter().enumerate().map(changed).collect();
}

/// Radiance of each texel, the mean of the groups by their `shares`.
fn mean_radiance(model: &Model, shares: &[f32]) -> Vec<[f32; 3]> {
    let mut mean = vec![[0.0f32; 3]; model.env_texels()];
    for (group, share) in shares.iter().enumerate() {
        for (mean, raw) in mean.iter_mut().zip(model.env_raw_of(group)) {
            (0..3).for_each(|c| mean[c] += share * softplus(raw[c]));
        }
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use relume_compare::largest_difference;
    use relume_engine::{Photo, PhotoLight, PhotoLights, TurnedLight, srgb};
    use relume_scene::{Camera, DisplayRange, Gaussians};

    /// A state whose light groups have uniform lights of these radiances.
    fn state(groups: &[[f32; 3]]) -> TrainState {
        let raw = groups.iter().flat_map(|radiance| [radiance.map(softplus_inverse); 8]).collect();
        TrainState::new(Model::new(Gaussians::zeroed(1, 1, 0, 0), vec![[0.5; 3]], raw, (4, 2)))
    }

    fn radiance(model: &Model, group: usize) -> [f32; 3] {
        model.environment(group).texels()[3]
    }

    /// Two photographs of `colour` under one light and four of twice that colour, with bluish light, under another.
    fn data(colour: f32) -> Dataset {
        let photo = |i: usize| {
            let group = usize::from(i > 1);
            let shown = if group == 0 { [colour; 3] } else { [2.0 * colour, 2.0 * colour, 4.0 * colour] };
            let eye = DVec3::new(0.0, -3.0, 0.0);
            Photo {
                camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.5, (4, 4)).unwrap(),
                pixels: vec![shown.map(srgb); 16],
                alpha: Vec::new(),
                light: PhotoLight { light: TurnedLight { group, radians: 0.0 }, block: group },
                range: DisplayRange::Unit,
            }
        };
        let mut data = Dataset::of_photos(&(0..6).map(photo).collect::<Vec<_>>());
        data.lights = PhotoLights::of(&[0, 0, 1, 1, 1, 1].map(|group| (group, 0.0))).0;
        data
    }

    #[test]
    fn lights_differ_as_the_mean_colours_of_their_photographs() {
        let found = relative_lights(&data(0.1));
        let all = [5.0 / 3.0, 5.0 / 3.0, 3.0];
        for (light, mean) in found.iter().zip([[1.0; 3], [2.0, 2.0, 4.0]]) {
            let level = luminance(mean) / luminance(all);
            assert!((light.level / level - 1.0).abs() < 1e-3, "{light:?}");
            let blue = (mean[2] / mean[0] / (all[2] / all[0])).ln();
            assert!((light.colour.blue_over_red - blue).abs() < 1e-3, "{light:?}");
        }
        assert!(found[1].level > 1.5 * found[0].level, "the control: {found:?}");
        let warm = LightColour { blue_over_red: -0.4, green: 0.1 };
        let own = found[1].colour_of(warm);
        assert!(own.blue_over_red > warm.blue_over_red);
        assert!((found[1].mean_colour(own).blue_over_red - warm.blue_over_red).abs() < 1e-6);
        let mut one = data(0.1);
        one.lights = PhotoLights::default();
        assert_eq!(relative_lights(&one), [RelativeLight::default()]);
    }

    #[test]
    fn environments_get_back_the_level_of_their_photographs() {
        let of = |level| RelativeLight { level, ..RelativeLight::default() };
        let mut model = state(&[[0.5, 1.0, 2.0], [1.0; 3]]).model;
        restore_levels(&mut model, &[of(2.0), of(3.0)]);
        assert!(largest_difference(&radiance(&model, 0), &[1.0, 2.0, 4.0]) < 1e-5);
        assert!(largest_difference(&radiance(&model, 1), &[3.0; 3]) < 1e-5);
        let mut one = state(&[[0.5; 3]]).model;
        let before = one.clone();
        restore_levels(&mut one, &[RelativeLight::default()]);
        assert_eq!(one, before, "one group keeps its bytes");
    }

    #[test]
    fn a_change_of_the_mean_light_keeps_the_ratio_of_groups() {
        let mut changed = state(&[[1.0; 3], [4.0; 3]]);
        let shares = [0.25, 0.75];
        change_mean_light(&mut changed, &shares, |state| {
            assert_eq!(state.model.light_groups(), 1, "the mean light alone");
            assert!(largest_difference(&radiance(&state.model, 0), &[3.25; 3]) < 1e-5);
            state.model.env_raw.fill([softplus_inverse(6.5); 3]);
        });
        assert!(largest_difference(&radiance(&changed.model, 0), &[2.0; 3]) < 1e-5);
        assert!(largest_difference(&radiance(&changed.model, 1), &[8.0; 3]) < 1e-5);
        let mut one = state(&[[1.0; 3]]);
        change_mean_light(&mut one, &[1.0], |state| state.model.env_raw.fill([7.0; 3]));
        assert!(one.model.env_raw.iter().all(|raw| *raw == [7.0; 3]), "one group: the change itself");
    }
}
