//! The gain of a photograph that results from automatic exposure and white balance.

use relume_engine::{Photo, linear_from_srgb, srgb};

/// Linear gain of a photograph, by channel.
pub type Gain = [f32; 3];

/// Divides the object's part of `photo`, without `background`, by `gain`; the result stays in the photograph's range.
pub fn divide(photo: &mut Photo, gain: Gain, background: [f32; 3]) {
    let Photo { pixels, alpha, range, .. } = photo;
    for (i, pixel) in pixels.iter_mut().enumerate() {
        let a = alpha.get(i).copied().unwrap_or(1.0);
        for c in 0..3 {
            let behind = (1.0 - a) * background[c];
            let shown = ((pixel[c] - behind) / a.max(1e-3)).clamp(0.0, range.white());
            pixel[c] = srgb((linear_from_srgb(shown) / gain[c]).min(range.peak())) * a + behind;
        }
    }
}
