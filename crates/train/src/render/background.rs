//! The environment as background of a frame.

use rayon::prelude::*;

use relume_engine::Frame;
use relume_scene::{Camera, EnvMap};
use relume_spec::rendering::Output;

/// Composites the `rgb` output of a frame of `camera` over `environment`, if the frame has that output. Alpha is
/// unchanged.
pub(super) fn show_environment(frame: &mut Frame, camera: &Camera, environment: &EnvMap) {
    let width = frame.width as usize;
    let Some(mut rgb) = frame.planes.remove(&Output::Rgb) else { return };
    if let Some(alpha) = frame.planes.get(&Output::Alpha).filter(|_| width > 0) {
        let rows = rgb.par_chunks_exact_mut(width * 3).zip(alpha.par_chunks_exact(width)).enumerate();
        rows.for_each(|(y, (row, alpha))| {
            for (x, (pixel, alpha)) in row.as_chunks_mut::<3>().0.iter_mut().zip(alpha).enumerate() {
                let open = (1.0 - alpha).clamp(0.0, 1.0);
                if open > 0.0 {
                    let behind = environment.sample(camera.ray(x as u32, y as u32));
                    (0..3).for_each(|k| pixel[k] += open * behind[k]);
                }
            }
        });
    }
    frame.planes.insert(Output::Rgb, rgb);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn environment_background_is_blended_behind_the_model() {
        let camera = Camera::look_at(DVec3::X * 3.0, DVec3::ZERO, DVec3::Z, 1.2, (9, 7)).unwrap();
        let sky = EnvMap::from_fn(64, 32, |d| [d.x as f32 + 1.0, d.y as f32 + 1.0, d.z as f32 + 1.0]);
        let alpha: Vec<f32> = (0..63).map(|i| [0.0, 0.25, 1.0][i % 3]).collect();
        let planes = [(Output::Rgb, vec![0.125; 63 * 3]), (Output::Alpha, alpha.clone())].into();
        let mut frame = Frame { width: 9, height: 7, planes };
        show_environment(&mut frame, &camera, &sky);
        for (i, pixel) in frame.planes[&Output::Rgb].as_chunks::<3>().0.iter().enumerate() {
            let d = camera.ray(i as u32 % 9, i as u32 / 9);
            for (value, d) in pixel.iter().zip([d.x, d.y, d.z]) {
                let expected = 0.125 + (1.0 - alpha[i]) * (d as f32 + 1.0);
                assert!((value - expected).abs() < 0.02, "{i}: {value}, not {expected}");
            }
        }
        assert_eq!(frame.planes[&Output::Alpha], alpha);
    }
}
