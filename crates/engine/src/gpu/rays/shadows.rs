//! Small lights, each with a shadow that is traced in every pixel.

use bytemuck::{Pod, Zeroable};

use crate::gpu::grow::grow;
use crate::gpu::permutations::groups;
use crate::gpu::raster::Blended;
use crate::gpu::rays::{RayMemory, TreeBuffers};
use crate::gpu::shading::Shading;
use crate::gpu::{Buffer, Groups, Recorder, shaders, uniform};
use crate::{DeviceError, towards_light};
use relume_layout::constants::SHADOW_SAMPLE_OFFSETS;
use relume_scene::light::{DominantLight, TableLight};
use relume_scene::{ShadeAt, ShadingOptions, SplitLight, VisibilityForm};

/// Maximum number of directions towards a light.
const MAX_DIRECTIONS: usize = 7;

/// `SharpLight` of `shaders/shared/sharp_light.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct SharpLightUniform {
    direction: [f32; 4],
    irradiance: [f32; 4],
    row_groups: u32,
    n_rays: u32,
    n_directions: u32,
    conserves_energy: u32,
    directions: [[f32; 4]; MAX_DIRECTIONS],
}

impl SharpLightUniform {
    /// `light` for surfaces of the forward model `options` whose rows have `row_groups` groups.
    fn new(light: &DominantLight, row_groups: usize, options: &ShadingOptions) -> Self {
        let [x, y, z] = light.direction.to_array().map(|v| v as f32);
        let [r, g, b] = light.irradiance.map(|v| v as f32);
        let towards = towards_light(&SplitLight::from(&TableLight::from(light)));
        let mut directions = [[0.0; 4]; MAX_DIRECTIONS];
        for (out, [x, y, z]) in directions.iter_mut().zip(&towards) {
            *out = [*x, *y, *z, 0.0];
        }
        let is_occluded = options.visibility != VisibilityForm::Off;
        let n_rays = if is_occluded { towards.len().max(SHADOW_SAMPLE_OFFSETS.len()) } else { 0 };
        Self {
            direction: [x, y, z, light.radius as f32],
            irradiance: [r, g, b, 0.0],
            row_groups: row_groups as u32,
            n_rays: n_rays as u32,
            n_directions: towards.len().min(MAX_DIRECTIONS) as u32,
            conserves_energy: u32::from(options.conserves_energy),
            directions,
        }
    }
}

impl RayMemory {
    /// Reflection of `lights` in each pixel of a full frame, each weighted by its arriving share: diffuse and specular radiance,
    /// planar, times coverage.
    ///
    /// # Errors
    /// As [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn sharp_lights(
        &mut self,
        recorder: &mut Recorder<'_>,
        frame: &Blended<'_>,
        shading: &Shading,
        tree: &TreeBuffers,
        lights: &[DominantLight],
    ) -> Result<Buffer<[f32; 4]>, DeviceError> {
        let depths = self.surface_depths(recorder, frame)?;
        let sent = grow(recorder.gpu(), "light sent", &mut self.sent, 2 * frame.camera().pixels())?;
        recorder.clear(&sent);
        let row_groups = groups(frame.attributed.channels);
        for light in lights {
            let light = SharpLightUniform::new(light, row_groups, &shading.options);
            let reflected = self.reflected(recorder, frame, shading, &light)?;
            let bindings = [
                uniform(frame.camera()),
                uniform(&light),
                uniform(&tree.rules),
                frame.gbuffer().into(),
                (&depths).into(),
                (&reflected).into(),
                (&tree.nodes).into(),
                (&tree.members).into(),
                (&sent).into(),
            ];
            recorder.stage("shadow rays");
            recorder.dispatch(&shaders::SHADOW_RAYS, frame.camera().tile_groups(), &bindings);
        }
        Ok(sent)
    }

    /// Reflection of an unoccluded light in each pixel: coverage and the sum, then 0 and the specular part, planar.
    fn reflected(
        &mut self,
        recorder: &mut Recorder<'_>,
        frame: &Blended<'_>,
        shading: &Shading,
        light: &SharpLightUniform,
    ) -> Result<Buffer<[f32; 4]>, DeviceError> {
        let (camera, gpu) = (frame.camera(), recorder.gpu());
        let reflected = grow(gpu, "light reflected", &mut self.reflected, 2 * camera.pixels())?;
        recorder.stage("light");
        let constants = &shading.constants.buffer;
        if shading.options.shade_at == ShadeAt::Pixel {
            let gbuffer = frame.gbuffer().into();
            let bindings = [uniform(camera), uniform(light), gbuffer, constants.into(), (&reflected).into()];
            recorder.dispatch(&shaders::REFLECTED_PIXELS, Groups::Linear(camera.pixels()), &bindings);
            return Ok(reflected);
        }
        let p = &frame.attributed.projected;
        let n = p.source.layout.n as usize;
        let rows = grow(gpu, "rows of reflected light", &mut self.rows, 2 * n)?;
        let ends = grow(gpu, "ends of reflected light", &mut self.ends, camera.pixels())?;
        let bindings = [
            uniform(camera),
            uniform(light),
            uniform(&p.source.layout),
            (&p.source.params).into(),
            (&p.splats).into(),
            (&frame.attributed.rows).into(),
            constants.into(),
            (&rows).into(),
        ];
        recorder.dispatch(&shaders::REFLECTED_ROWS, Groups::Linear(n), &bindings);
        p.blend_pairs(recorder, &rows, &reflected, &ends);
        Ok(reflected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::shaders::assert_layout;

    #[test]
    fn lights_are_laid_out_as_the_shaders_read_them() {
        assert_layout!(
            SharpLightUniform as "SharpLight" in shaders::SHADOW_RAYS;
            direction, irradiance, row_groups, n_rays, n_directions, conserves_energy, directions
        );
    }

    #[test]
    fn number_of_light_samples_fits_the_shader_array() {
        let wide = DominantLight { direction: glam::DVec3::Z, irradiance: [1.0; 3], radius: 0.5 };
        let uniform = SharpLightUniform::new(&wide, 5, &ShadingOptions::default());
        let towards = towards_light(&SplitLight::from(&TableLight::from(&wide)));
        assert_eq!((uniform.n_directions as usize, uniform.n_rays as usize), (towards.len(), towards.len()));
        let point =
            SharpLightUniform::new(&DominantLight { radius: 0.0, ..wide }, 5, &ShadingOptions::default());
        assert_eq!(
            (point.n_directions, point.n_rays),
            (1, SHADOW_SAMPLE_OFFSETS.len() as u32),
            "the control"
        );
        let open = ShadingOptions { visibility: VisibilityForm::Off, ..ShadingOptions::default() };
        assert_eq!(SharpLightUniform::new(&wide, 5, &open).n_rays, 0);
    }
}
