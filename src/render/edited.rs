//! A frame whose surfaces are edited before they are shaded.

use crate::engine::channel::Channels;
use crate::engine::cpu::{Pass, Shader, Surface};
use crate::engine::gpu::GpuError;
use crate::render::develop::develop;
use crate::render::standard::shade_here;
use crate::render::{Frame, Output, PreparedLight, RenderError, Renderer};
use crate::scene::{Camera, Field, ShadeAt, ShadingOptions};

impl Renderer {
    /// Colour and alpha of a view, with `edit(shader, pixel, surface)` called on what each row-major pixel sees before it is
    /// shaded as the standard tier does: what a layer is worth is found by putting the truth in its place.
    ///
    /// # Errors
    /// Names the camera field that cannot be rendered; a light prepared on a GPU has no surfaces to edit.
    pub fn render_edited(
        &self,
        camera: &Camera,
        light: &PreparedLight,
        edit: &(dyn Fn(&Shader<'_>, usize, &mut Surface) + Sync),
    ) -> Result<Frame, RenderError> {
        let view = self.view(camera)?;
        let (None, Some(light)) = (&light.on_gpu, light.on_cpu.get()) else {
            return Err(GpuError::Misuse("surfaces are edited on the CPU engine only".to_owned()).into());
        };
        // Deferred whatever the model: what is edited is in the pixel.
        let options = ShadingOptions { shade_at: ShadeAt::Pixel, ..self.model().shading };
        let source = self.source(&light.gathered, &light.indirect_basis);
        let shader =
            Shader { tables: &light.tables, options: &options, order: source.gaussians.visibility_order() };
        let coefficients = source.gaussians.width(Field::Visibility);
        let pass = Pass::forward(&source, view, Channels::Full(coefficients), true);
        let outputs = [Output::Rgb, Output::Alpha];
        Ok(develop(&pass, &shader, &outputs, 1.0, |(x, y), surface| {
            let mut surface = *surface;
            edit(&shader, y * view.width + x, &mut surface);
            shade_here(&shader, &surface)
        }))
    }
}
