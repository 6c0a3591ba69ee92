//! What a viewer elsewhere needs to show a model as the standard tier does.

use crate::render::viewpoint::framing;
use crate::render::{PreparedLight, Renderer};
use relume_capture::formats::viewer_stream::{
    StreamedLight, StreamedSurface, encode_gaussians, encode_light, importance_order,
};
use relume_scene::light::reflectance_tables;
use relume_scene::{Model, SplitLight};

/// Most rows of the picture of a light that stands behind a model.
const MAX_MAP_ROWS: usize = 256;

/// The stream of a model's Gaussians (docs/viewer-stream.md).
pub fn stream_gaussians(model: &Model) -> Vec<u8> {
    encode_gaussians(model, &framing(model))
}

impl Renderer {
    /// The stream of a light for this model, with a picture of the light where that is wanted. What another device prepared is
    /// prepared anew on the CPU engine the first time.
    pub fn stream_light(&self, light: &PreparedLight, with_map: bool) -> Vec<u8> {
        let on_cpu = self.light_on_cpu(light);
        let source = self.frames.on_cpu().lit_source(on_cpu);
        let surface = |i: usize| {
            let incident = source.incident(i);
            let arriving = source.arriving_at(i);
            StreamedSurface { gathered: incident.gathered, blocked: incident.blocked, arriving }
        };
        let tables = &on_cpu.tables;
        let lights: Vec<SplitLight> = tables.lights.iter().map(SplitLight::from).collect();
        encode_light(&StreamedLight {
            reflectance: reflectance_tables(),
            tables: tables.flat(),
            diffuse_nodes: tables.diffuse_grid.edge(),
            coefficients: tables.coefficients,
            specular_nodes: tables.specular_grids.iter().map(|grid| grid.edge()).collect(),
            lights: &lights,
            surfaces: importance_order(&self.model().gaussians).into_iter().map(surface).collect(),
            map: with_map.then(|| light.source.environment.clone().at_most_rows(MAX_MAP_ROWS)),
        })
    }
}
