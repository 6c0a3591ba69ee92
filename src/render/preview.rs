//! The preview tier: shade every visible Gaussian once, then blend three channels.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::engine::channel::{self, Channels};
use crate::engine::cpu::{
    AttributeSource, MAX_COEFFICIENTS, Pass, Shader, Surface, View, normalise, project_all,
};
use crate::render::{Frame, Output};
use crate::scene::Field;

/// Renders `rgb` and `alpha`.
pub fn render(source: &AttributeSource<'_>, view: View, shader: &Shader<'_>) -> Frame {
    let splats = project_all(source, &view);
    let full = Channels::Full(source.gaussians.width(Field::Visibility));
    let stored = Channels::Colour.stored();
    let mut attributes = vec![0.0f32; splats.len() * stored];
    attributes.par_chunks_mut(stored).zip(&splats).with_min_len(64).for_each_init(
        || vec![0.0f32; full.stored()],
        |row, (out, splat)| {
            row.fill(0.0);
            source.write(&view, splat, full, row);
            let mean: [f32; 3] = source.gaussians.get(Field::Mean, splat.gaussian as usize);
            let shaded = shader.shade(&surface(row, view.eye, mean));
            out[channel::COVERAGE] = 1.0;
            for (c, k) in channel::RADIANCE.enumerate() {
                out[k] = shaded.diffuse[c] + shaded.specular[c];
            }
        },
    );
    let pass = Pass::blend(view, splats, Channels::Colour, attributes, true);
    let pixels = (0..view.width * view.height).map(|i| (i % view.width, i / view.width));
    let rgb = pixels.clone().flat_map(|(x, y)| channel::RADIANCE.map(move |c| (x, y, c)));
    let planes = BTreeMap::from([
        (Output::Rgb, rgb.map(|(x, y, c)| pass.at(x, y, c)).collect()),
        (Output::Alpha, pixels.map(|(x, y)| pass.at(x, y, channel::COVERAGE)).collect()),
    ]);
    Frame { width: view.width as u32, height: view.height as u32, planes }
}

/// One Gaussian's attributes as a surface seen from `eye`.
fn surface(row: &[f32], eye: [f32; 3], mean: [f32; 3]) -> Surface {
    let triple = |r: std::ops::Range<usize>| std::array::from_fn(|k| row[r.start + k]);
    let mut visibility = [0.0f32; MAX_COEFFICIENTS];
    for (v, c) in visibility.iter_mut().zip(&row[channel::VISIBILITY..]) {
        *v = *c;
    }
    Surface {
        normal: triple(channel::NORMAL),
        albedo: triple(channel::ALBEDO),
        metal: row[channel::METAL],
        rough: row[channel::ROUGH],
        gathered: triple(channel::GATHERED),
        indirect: triple(channel::INDIRECT),
        visibility,
        view: normalise(std::array::from_fn(|k| eye[k] - mean[k])).0,
    }
}
