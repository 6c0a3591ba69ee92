//! A frame whose surfaces are edited before they are shaded.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::engine::channel::{self, Channels};
use crate::engine::cpu::{Pass, Shader, Surface, View, surface_at};
use crate::engine::gpu::GpuError;
use crate::render::renderer::{Engine, Prepared};
use crate::render::{Frame, Output, PreparedLight, RenderError, Renderer};
use crate::scene::{Camera, Field};

impl Renderer {
    /// Colour and alpha of a view, with `edit(shader, pixel, surface)` called on what each row-major pixel sees before it is
    /// shaded as the standard tier does: what a layer is worth is found by putting the truth in its place.
    ///
    /// # Errors
    /// Names the camera field that cannot be rendered; a renderer on a GPU has no surfaces to edit.
    pub fn render_edited(
        &self,
        camera: &Camera,
        light: &PreparedLight,
        edit: &(dyn Fn(&Shader<'_>, usize, &mut Surface) + Sync),
    ) -> Result<Frame, RenderError> {
        let camera = self.camera_inside(camera)?;
        let (Engine::Cpu(_), Prepared::Cpu(light)) = (&self.engine, &light.0) else {
            return Err(GpuError::Internal("surfaces are edited on the CPU engine only".to_owned()).into());
        };
        let options = &self.model().shading;
        let source = self.source(&light.gathered, &light.indirect_basis);
        let coefficients = source.gaussians.width(Field::Visibility);
        let pass = Pass::forward(&source, View::new(&camera, options), Channels::Full(coefficients), true);
        let shader = Shader { tables: &light.tables, options, order: source.gaussians.visibility_order() };
        let (width, height) = (pass.view.width, pass.view.height);
        let pixels: Vec<[f32; 4]> = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let alpha = pass.at(x, y, channel::COVERAGE);
                let Some((mut surface, coverage)) = surface_at(&pass, x, y) else {
                    return [0.0, 0.0, 0.0, alpha];
                };
                edit(&shader, i, &mut surface);
                let shaded = shader.shade(&surface);
                let [r, g, b] = std::array::from_fn(|c| (shaded.diffuse[c] + shaded.specular[c]) * coverage);
                [r, g, b, alpha]
            })
            .collect();
        let planes = BTreeMap::from([
            (Output::Rgb, pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect()),
            (Output::Alpha, pixels.iter().map(|p| p[3]).collect()),
        ]);
        Ok(Frame { width: width as u32, height: height as u32, planes })
    }
}
