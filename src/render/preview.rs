//! The preview tier: shade every visible Gaussian once, then blend three channels.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::engine::channel::{self, Channels};
use crate::engine::cpu::{AttributeSource, Pass, Shader, View, attribute_rows, project_all, surface_of_row};
use crate::render::{Frame, Output};
use crate::scene::Field;

/// Renders `rgb` and `alpha`.
pub fn render(source: &AttributeSource<'_>, view: View, shader: &Shader<'_>) -> Frame {
    let source = &source.under(*shader);
    let splats = project_all(source, &view);
    let full = Channels::Full(source.gaussians.width(Field::Visibility));
    let rows = attribute_rows(source, &view, &splats, full, full.stored());
    let stored = Channels::Colour.stored();
    let mut attributes = vec![0.0f32; splats.len() * stored];
    let places = attributes.par_chunks_mut(stored).zip(rows.par_chunks(full.stored())).zip(&splats);
    places.with_min_len(64).for_each(|((out, row), splat)| {
        let mean: [f32; 3] = source.gaussians.get(Field::Mean, splat.gaussian as usize);
        let to_mean = std::array::from_fn(|k| mean[k] - view.eye[k]);
        let shaded = shader.shade(&surface_of_row(row, to_mean));
        out[channel::COVERAGE] = 1.0;
        for (c, k) in channel::RADIANCE.enumerate() {
            out[k] = shaded.diffuse[c] + shaded.specular[c];
        }
    });
    let pass = Pass::blend(view, splats, Channels::Colour, attributes, true);
    let pixels = (0..view.width * view.height).map(|i| (i % view.width, i / view.width));
    let rgb = pixels.clone().flat_map(|(x, y)| channel::RADIANCE.map(move |c| (x, y, c)));
    let planes = BTreeMap::from([
        (Output::Rgb, rgb.map(|(x, y, c)| pass.at(x, y, c)).collect()),
        (Output::Alpha, pixels.map(|(x, y)| pass.at(x, y, channel::COVERAGE)).collect()),
    ]);
    Frame { width: view.width as u32, height: view.height as u32, planes }
}
