//! The streams with which a viewer shows a model as in the standard tier.

use crate::render::viewpoint::framing;
use crate::render::{PreparedLight, Renderer};
use relume_capture::formats::viewer_stream::{
    StreamedLight, StreamedSurface, encode_gaussians, encode_light, importance_order,
};
use relume_scene::light::map_rows::VIEWER_ROWS;
use relume_scene::light::reflectance_tables;
use relume_scene::{Model, SplitLight};

/// The stream of a model's Gaussians (docs/viewer-stream.md).
pub fn stream_gaussians(model: &Model) -> Vec<u8> {
    encode_gaussians(model, &framing(model))
}

impl Renderer {
    /// The stream of a light for this model, optionally with a map of the light. A light that was prepared on another
    /// device is prepared on the host the first time.
    pub fn stream_light(&self, light: &PreparedLight, with_map: bool) -> Vec<u8> {
        let host = self.light_on_host(light);
        let surface = |i: usize| {
            let (incident, arriving) = (host.incident(i), host.arriving_at(i));
            StreamedSurface { gathered: incident.gathered, blocked: incident.blocked, arriving }
        };
        let tables = &host.tables;
        let lights: Vec<SplitLight> = tables.lights.iter().map(SplitLight::from).collect();
        encode_light(&StreamedLight {
            reflectance: reflectance_tables(),
            tables: tables.flat(),
            diffuse_nodes: tables.diffuse_grid.edge(),
            coefficients: tables.coefficients,
            specular_nodes: tables.specular_grids.iter().map(|grid| grid.edge()).collect(),
            lights: &lights,
            surfaces: importance_order(&self.model().gaussians).into_iter().map(surface).collect(),
            map: with_map.then(|| light.source.environment.clone().at_most_rows(VIEWER_ROWS)),
        })
    }
}
