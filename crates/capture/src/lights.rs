//! Built-in environments: smooth procedural skies and studios, for demos, tests and requests by name.

use glam::{DVec3, Vec3};

use relume_scene::EnvMap;

/// Names of the built-in environments, for [`builtin`].
pub const BUILTIN: &[&str] = &["studio", "sunset", "overcast", "dawn", "night", "white"];

/// Width of the built-in maps, texels; their height is half of it.
const WIDTH: usize = 128;

/// A built-in environment by name, 128 x 64 texels, mean luminance 0.7 (`night` 0.25, `white` 1).
///
/// ```
/// let map = relume_capture::builtin("studio").unwrap();
/// assert_eq!((map.width(), map.height()), (128, 64));
/// assert!(relume_capture::builtin("no such light").is_none());
/// ```
pub fn builtin(name: &str) -> Option<EnvMap> {
    let (sky, mean): (Sky, f32) = match name {
        "studio" => (STUDIO, 0.7),
        "sunset" => (SUNSET, 0.7),
        "overcast" => (OVERCAST, 0.7),
        "dawn" => (DAWN, 0.7),
        "night" => (NIGHT, 0.25),
        "white" => return Some(EnvMap::constant(WIDTH, WIDTH / 2, [1.0; 3])),
        _ => return None,
    };
    let map = EnvMap::from_fn(WIDTH, WIDTH / 2, |d| sky.radiance(d).to_array());
    let gain = mean / mean_luminance(&map);
    Some(map.rotated_and_scaled(0.0, gain))
}

/// Three colours over elevation and a few soft lamps.
struct Sky {
    zenith: Vec3,
    horizon: Vec3,
    ground: Vec3,
    /// Direction (not normalised), sharpness of the lobe, peak radiance.
    lamps: &'static [([f64; 3], f64, Vec3)],
}

impl Sky {
    fn radiance(&self, d: DVec3) -> Vec3 {
        let up = d.z as f32;
        let sky = self.horizon.lerp(self.zenith, up.max(0.0).powf(0.7));
        // The ground replaces the sky within a few degrees of the horizon, without a visible edge.
        let below = 1.0 / (1.0 + (up * 12.0).exp());
        let mut sum = sky.lerp(self.ground, below);
        for &(direction, sharpness, peak) in self.lamps {
            let cosine = d.dot(DVec3::from(direction).normalize());
            sum += peak * (sharpness * (cosine - 1.0)).exp() as f32;
        }
        sum
    }
}

const fn rgb(r: f32, g: f32, b: f32) -> Vec3 {
    Vec3::new(r, g, b)
}

const STUDIO: Sky = Sky {
    zenith: rgb(0.45, 0.46, 0.48),
    horizon: rgb(0.30, 0.30, 0.32),
    ground: rgb(0.22, 0.21, 0.20),
    lamps: &[
        ([0.8, 0.5, 0.7], 16.0, rgb(5.0, 4.8, 4.5)),
        ([-0.9, 0.3, 0.5], 9.0, rgb(1.6, 1.8, 2.1)),
        ([-0.1, -1.0, 0.35], 22.0, rgb(2.4, 2.4, 2.5)),
    ],
};

const SUNSET: Sky = Sky {
    zenith: rgb(0.16, 0.24, 0.46),
    horizon: rgb(0.85, 0.48, 0.26),
    ground: rgb(0.12, 0.10, 0.09),
    lamps: &[([0.3, -1.0, 0.3], 24.0, rgb(14.0, 7.0, 2.6)), ([0.2, -1.0, 0.15], 4.0, rgb(0.8, 0.35, 0.15))],
};

const OVERCAST: Sky = Sky {
    zenith: rgb(1.15, 1.20, 1.28),
    horizon: rgb(0.62, 0.65, 0.70),
    ground: rgb(0.16, 0.17, 0.14),
    lamps: &[([-0.5, 0.6, 1.0], 3.0, rgb(0.5, 0.5, 0.48))],
};

const DAWN: Sky = Sky {
    zenith: rgb(0.22, 0.30, 0.52),
    horizon: rgb(0.70, 0.52, 0.58),
    ground: rgb(0.13, 0.12, 0.14),
    lamps: &[([-1.0, 0.2, 0.25], 10.0, rgb(4.2, 2.6, 2.2)), ([1.0, 0.3, 0.4], 3.0, rgb(0.15, 0.25, 0.45))],
};

const NIGHT: Sky = Sky {
    zenith: rgb(0.010, 0.014, 0.030),
    horizon: rgb(0.030, 0.034, 0.050),
    ground: rgb(0.010, 0.010, 0.012),
    lamps: &[([0.6, -0.7, 0.5], 40.0, rgb(3.0, 2.0, 0.9)), ([-0.7, -0.5, 0.6], 20.0, rgb(0.2, 0.5, 1.4))],
};

/// Mean Rec.709 luminance over the sphere.
fn mean_luminance(map: &EnvMap) -> f32 {
    let dirs = relume_scene::texel_directions(map.width(), map.height());
    let luminance = |t: &[f32; 3]| f64::from(0.2126 * t[0] + 0.7152 * t[1] + 0.0722 * t[2]);
    let sum: f64 = map.texels().iter().zip(dirs).map(|(t, (_, w))| luminance(t) * w).sum();
    (sum / (4.0 * std::f64::consts::PI)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_builtin_light_is_finite_distinct_and_of_known_mean() {
        let maps: Vec<EnvMap> = BUILTIN.iter().map(|n| builtin(n).unwrap()).collect();
        for (i, map) in maps.iter().enumerate() {
            assert!(map.texels().iter().flatten().all(|v| v.is_finite() && *v > 0.0), "{}", BUILTIN[i]);
            assert!((0.2..1.01).contains(&mean_luminance(map)), "{}", BUILTIN[i]);
            assert!(maps[..i].iter().all(|other| other != map), "{} equals another", BUILTIN[i]);
        }
    }

    #[test]
    fn sunset_light_has_its_sun_in_the_expected_direction() {
        let map = builtin("sunset").unwrap();
        let sun = DVec3::new(0.3, -1.0, 0.3).normalize();
        assert!(map.sample(sun)[0] > 5.0 * map.sample(-sun)[0]);
    }
}
