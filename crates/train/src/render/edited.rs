//! Renders a frame whose surfaces are edited before shading.

use crate::render::{Frame, PreparedLight, RenderError, Renderer};
use relume_engine::DeviceError;
use relume_engine::cpu::{Pass, Surface, SurfaceShader, resolve};
use relume_layout::channel::Channels;
use relume_layout::constants::EarlyStop;
use relume_scene::{Camera, Field, ShadeAt, ShadingOptions};
use relume_spec::rendering::Output;

impl Renderer {
    /// Colour and alpha of a view. `edit(shader, pixel, surface)` is called for the surface of each row-major pixel
    /// before it is shaded as in the standard tier, e.g. to replace a layer by ground truth.
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
            return Err(
                DeviceError::Misuse("surfaces can only be edited on the CPU engine".to_owned()).into()
            );
        };
        // Shaded per pixel for every model, because the edited surface is that of the pixel.
        let options = ShadingOptions { shade_at: ShadeAt::Pixel, ..self.model().shading };
        let source = cpu.lit_source(on_cpu);
        // The tables include all lights, so no light is shaded separately.
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
