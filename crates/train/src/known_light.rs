//! The measured light of the photographs, if it is known.

use relume_capture::Capture;
use relume_engine::upward_share;
use relume_scene::light::{UPWARD_LUMINANCE, luminance};
use relume_scene::{EnvMap, texel_directions};
use relume_spec::training::{Auto, KnownLight, LightExposure, MAX_STOPS};

/// Deviation from the usual level above which a map probably has another scale than the photographs, stops.
const MAX_EXPOSURE_OFFSET: f64 = 1.0;

/// Adds the measured map to `capture`, with a warning if its scale probably differs from that of the photographs.
pub fn illuminate(light: &KnownLight, capture: &mut Capture, map: EnvMap) {
    if let LightExposure::Stops(ev) = light.exposure_ev {
        let off = level(&map).log2() + ev;
        if off.abs() > MAX_EXPOSURE_OFFSET {
            capture.warnings.push(format!(
                "light: under this map a white surface that faces up is {off:+.1} stops from its usual level in photographs; \
                 a map with another scale than the photographs causes wrong albedo (exposure \"auto\" assumes 0)"
            ));
        }
    }
    capture.measured_light = Some(map);
}

/// `map` with the rotation and exposure of the photographs.
pub(crate) fn applied(light: &KnownLight, map: &EnvMap) -> EnvMap {
    let gain = match light.exposure_ev {
        LightExposure::Stops(ev) => ev.exp2(),
        // At most the largest exposure in stops, so that a map without light from above stays finite.
        LightExposure::Unknown(Auto::Auto) => level(map).recip().min(MAX_STOPS.exp2()),
    };
    map.rotated_and_scaled(light.rotation_deg, gain as f32)
}

/// Luminance of a white horizontal surface that faces up, relative to the level at which an unknown light is held;
/// never 0.
fn level(map: &EnvMap) -> f64 {
    let texels = map.texels().iter().zip(texel_directions(map.width(), map.height()));
    let level: f64 = texels.map(|(t, at)| f64::from(upward_share(&at) * luminance(*t))).sum();
    (level / f64::from(UPWARD_LUMINANCE)).max(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(exposure_ev: LightExposure) -> KnownLight {
        KnownLight { environment: "sky".into(), rotation_deg: 0.0, exposure_ev }
    }

    #[test]
    fn auto_exposure_normalises_the_light_and_given_stops_are_kept() {
        let sky = EnvMap::from_fn(64, 32, |d| [3.0 * (d.z.max(0.0) as f32), 0.5, 0.25]);
        let expected = luminance([2.0, 0.5, 0.25]) / UPWARD_LUMINANCE;
        assert!((level(&sky) - f64::from(expected)).abs() < 5e-3);
        assert!((level(&applied(&light(LightExposure::AUTO), &sky)) - 1.0).abs() < 1e-6);
        let floor = EnvMap::from_fn(8, 4, |d| [if d.z < 0.0 { 1e30 } else { 0.0 }; 3]);
        let lit = applied(&light(LightExposure::AUTO), &floor);
        assert!(
            lit.texels().iter().flatten().all(|v| v.is_finite()),
            "without light from above the result is finite"
        );
        let given = applied(&light(LightExposure::Stops(2.0)), &sky);
        assert!((level(&given) / level(&sky) - 4.0).abs() < 1e-5);
    }
}
