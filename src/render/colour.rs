//! Colour alone, of Gaussians that are shaded once and blended in three channels: the preview tier, and the standard tier
//! of models that are shaded at their Gaussians.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::engine::channel::{self, Channels, OutgoingRadiance, RowLight};
use crate::engine::constants::EarlyStop;
use crate::engine::cpu::{AttributeSource, Pass, SurfaceShader, View, attribute_rows, project_all};
use crate::render::{Frame, Output};

/// Renders `rgb` and `alpha`.
pub fn render(source: &AttributeSource<'_>, view: View, shader: &SurfaceShader<'_>) -> Frame {
    let source = &source.shaded(*shader);
    let splats = project_all(source, &view);
    let material = Channels::Material.stored();
    let rows = attribute_rows(source, &view, &splats, Channels::Material, material);
    let stored = Channels::Colour.stored();
    let mut attributes = vec![0.0f32; splats.len() * stored];
    let places = attributes.par_chunks_mut(stored).zip(rows.par_chunks(material));
    places.with_min_len(64).for_each(|(out, row)| {
        out[channel::COVERAGE] = row[channel::COVERAGE];
        out[channel::RADIANCE].copy_from_slice(&row[OutgoingRadiance::TOTAL]);
    });
    let pass =
        Pass::blend(view, splats, Channels::Colour, RowLight::Outgoing, attributes, EarlyStop::WhenSaturated);
    let pixels = (0..view.width * view.height).map(|i| (i % view.width, i / view.width));
    let rgb = pixels.clone().flat_map(|(x, y)| channel::RADIANCE.map(move |c| (x, y, c)));
    let planes = BTreeMap::from([
        (Output::Rgb, rgb.map(|(x, y, c)| pass.at(x, y, c)).collect()),
        (Output::Alpha, pixels.map(|(x, y)| pass.at(x, y, channel::COVERAGE)).collect()),
    ]);
    Frame { width: view.width as u32, height: view.height as u32, planes }
}
