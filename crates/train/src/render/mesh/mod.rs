//! Extracts the surface of a model as textured triangles, for programs without splats. Depths of many views are fused
//! into a signed distance field; the surface is its zero level set, and materials come from the same views.

mod atlas;
mod field;
mod surface;
mod views;

use glam::Vec3;

use crate::render::mesh::atlas::Atlas;
use crate::render::mesh::field::DistanceField;
use crate::render::mesh::views::DepthView;
use crate::render::renderer::Renderer;
use crate::render::{PreparedLight, RenderError};
use relume_capture::formats::gltf::TexturedMesh;
use relume_scene::{Camera, Output};

/// Resolution of a mesh extraction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshOptions {
    /// Cells of the field along the unit ball of the model's world, 16 to 512.
    pub cells: usize,
    /// Number of views.
    pub views: usize,
    /// Side of each view, pixels.
    pub size: u32,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self { cells: 192, views: 64, size: 512 }
    }
}

impl Renderer {
    /// The surface in the unit ball of the model's world, in capture coordinates. Parts that no view shows have no
    /// surface: views are from above the horizon or slightly below, so the underside of an object stays open.
    /// `is_wanted` is asked before each view.
    ///
    /// # Errors
    /// If the model has no surface, the options are out of range, or the device failed; [`RenderError::Abandoned`] if `is_wanted` returns
    /// false.
    pub fn mesh(
        &self,
        options: MeshOptions,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<TexturedMesh, RenderError> {
        let view = |light: &PreparedLight, camera: &Camera, outputs: &[Output]| match is_wanted() {
            true => DepthView::new(self, light, camera, outputs),
            false => Err(RenderError::Abandoned),
        };
        let refused = |field, reason: &str| RenderError::Refused { field, reason: reason.to_owned() };
        if !(16..=512).contains(&options.cells) {
            return Err(refused("cells", "must be 16 to 512"));
        }
        if options.views == 0 {
            return Err(refused("views", "must be at least 1"));
        }
        let cameras = views::around(self.model(), options.views, options.size)?;
        let light = self.prepare_light(self.model().recovered_light())?;
        let mut field = DistanceField::new(options.cells);
        for camera in &cameras {
            field.add(&view(&light, camera, &[Output::Depth])?);
        }
        let surface = surface::of(&field);
        if surface.quads.is_empty() {
            return Err(refused("model", "shows no surface"));
        }
        let mut atlas = Atlas::new(&surface).ok_or_else(|| refused("cells", "are too many for a texture"))?;
        let outputs = [Output::Depth, Output::Normal, Output::Albedo, Output::Metallic, Output::Roughness];
        for camera in &cameras {
            atlas.add(&view(&light, camera, &outputs)?, 2.0 * field.cell());
        }
        let model = self.model();
        let to_capture = |p: Vec3| (p.as_dvec3() / model.world_scale - model.world_offset).as_vec3();
        atlas.into_mesh(&surface, to_capture).map_err(|e| refused("mesh", &e.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::sync::Arc;

    use super::*;
    use relume_scene::{Field, Gaussians, Model, softplus_inverse};

    /// One opaque ball.
    fn ball() -> Renderer {
        let mut g = Gaussians::zeroed(1, 1, 0, 0);
        g.row_mut(Field::LogScale, 0).fill(-1.2);
        g.row_mut(Field::Quaternion, 0)[0] = 1.0;
        g.row_mut(Field::OpacityLogit, 0)[0] = 9.0;
        g.row_mut(Field::Normal, 0)[2] = 1.0;
        Renderer::new(Arc::new(Model::new(g, vec![[0.5; 3]], vec![[softplus_inverse(1.0); 3]; 8], (4, 2))))
    }

    #[test]
    fn mesh_that_nobody_waits_for_ends_at_the_next_view() {
        let (renderer, asked) = (ball(), Cell::new(0));
        let options = MeshOptions { cells: 16, views: 8, size: 32 };
        let mesh = |views: usize| {
            asked.set(0);
            renderer.mesh(options, &|| {
                asked.set(asked.get() + 1);
                asked.get() <= views
            })
        };
        assert!(matches!(mesh(3), Err(RenderError::Abandoned)));
        assert_eq!(asked.get(), 4);
        assert!(matches!(mesh(10), Err(RenderError::Abandoned)), "in the second pass");
        assert!(mesh(usize::MAX).is_ok(), "the control");
        assert_eq!(asked.get(), 16, "each view is rendered twice");
    }
}
