//! Renders a frame whose surfaces are edited before shading.

use crate::render::{Frame, PreparedLight, RenderError, Renderer};
use relume_engine::SurfaceEdit;
use relume_scene::Camera;

impl Renderer {
    /// Colour and alpha of a view, rendered on the host. `edit(shader, pixel, surface)` is called for the surface of each
    /// row-major pixel before it is shaded as in the standard tier, e.g. to replace a layer by ground truth.
    ///
    /// # Errors
    /// Names the camera field that cannot be rendered. Refuses a light of another renderer.
    pub fn render_edited(
        &self,
        camera: &Camera,
        light: &PreparedLight,
        edit: &SurfaceEdit<'_>,
    ) -> Result<Frame, RenderError> {
        self.check_light(light)?;
        let (view, host) = (self.view(camera)?, self.light_on_host(light));
        // The tables include all lights, so no light is shaded separately.
        let tables = light.whole_tables(host, self.model().gaussians.visibility_degree());
        Ok(host.render_edited(view, tables, edit))
    }
}
