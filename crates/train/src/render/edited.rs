//! A frame whose surfaces are edited before they are shaded.

use crate::render::{Frame, PreparedLight, RenderError, Renderer};
use relume_engine::DeviceError;
use relume_engine::cpu::{Pass, Surface, SurfaceShader, resolve};
use relume_layout::channel::Channels;
use relume_layout::constants::EarlyStop;
use relume_scene::{Camera, Field, ShadeAt, ShadingOptions};
use relume_spec::rendering::Output;

impl Renderer {
    /// Colour and alpha of a view, with `edit(shader, pixel, surface)` called on what each row-major pixel sees before it is
    /// shaded as the standard tier does: what a layer is worth is found by putting the truth in its place.
    ///
    /// # Errors
    /// Names the camera field that cannot be rendered; [`DeviceError::Misuse`] for a renderer on a GPU.
    pub fn render_edited(
        &self,
        camera: &Camera,
        light: &PreparedLight,
        edit: &(dyn Fn(&SurfaceShader<'_>, usize, &mut Surface) + Sync),
    ) -> Result<Frame, RenderError> {
        let view = self.view(camera)?;
        let cpu = self.frames.on_cpu();
        let Some(on_cpu) = light.frame.on_cpu() else {
            return Err(DeviceError::Misuse("surfaces are edited on the CPU engine only".to_owned()).into());
        };
        // Deferred whatever the model: what is edited is in the pixel.
        let options = ShadingOptions { shade_at: ShadeAt::Pixel, ..self.model().shading };
        let source = cpu.lit_source(on_cpu);
        // No light is shaded by itself in the pixel.
        let tables = light.whole_tables(on_cpu, self.model().gaussians.visibility_degree());
        let shader = SurfaceShader { options: &options, ..cpu.shader(tables) };
        let coefficients = source.gaussians.width(Field::Visibility);
        let pass = Pass::forward(&source, view, Channels::Full(coefficients), EarlyStop::WhenSaturated);
        let outputs = [Output::Rgb, Output::Alpha];
        Ok(resolve(&pass, &shader, &outputs, 1.0, |(x, y), surface| {
            let mut surface = *surface;
            edit(&shader, y * view.width + x, &mut surface);
            shader.shade(&surface).outgoing()
        }))
    }
}
