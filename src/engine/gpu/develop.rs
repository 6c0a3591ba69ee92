//! From a G-buffer to the planes of a frame, and the preview tier's colours.

use bytemuck::{Pod, Zeroable};

use crate::engine::gpu::model::LayoutUniform;
use crate::engine::gpu::shading::{ShadeJob, by_coefficients};
use crate::engine::gpu::{Buffer, GpuError, Groups, Recorder, SplatRecord, shaders, uniform};

/// `Develop` of `shaders/develop.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct DevelopUniform {
    wanted: u32,
    depth_scale: f32,
    infinity: f32,
    pad: u32,
}

/// Writes the planes named in `wanted` (bit k: output k of `render::Output`, in that order, one after the other, each
/// row-major with its own channels) into `planes`, which must hold them all. `depth_scale`: capture units a world unit.
///
/// # Errors
/// [`GpuError::Internal`] for a number of visibility coefficients that no field has.
pub fn develop(
    recorder: &mut Recorder<'_>,
    job: &ShadeJob<'_>,
    wanted: u32,
    depth_scale: f32,
    planes: &Buffer<f32>,
) -> Result<(), GpuError> {
    use shaders::*;
    let shaders =
        [&DEVELOP_1, &DEVELOP_4, &DEVELOP_9, &DEVELOP_16, &DEVELOP_25, &DEVELOP_36, &DEVELOP_49];
    let shader = by_coefficients(job.n_visibility, shaders)?;
    let options = DevelopUniform { wanted, depth_scale, infinity: f32::INFINITY, pad: 0 };
    let tiles = Groups::Grid(job.view.tiles[0], job.view.tiles[1]);
    recorder.stage("develop");
    job.dispatch(recorder, shader, tiles, vec![uniform(&options), job.gbuffer.into(), planes.into()]);
    Ok(())
}

/// What the preview tier shades: full attribute rows by Gaussian, where they are and whether they are seen.
#[derive(Debug, Clone, Copy)]
pub struct PreviewSource<'a> {
    /// Layout of `params`.
    pub model: &'a LayoutUniform,
    /// Planar parameters.
    pub params: &'a Buffer<f32>,
    /// Splats by Gaussian.
    pub splats: &'a Buffer<SplatRecord>,
    /// Full attribute rows.
    pub rows: &'a Buffer<[f32; 4]>,
}

/// Shades every visible Gaussian once into rows of coverage and linear colour. The job's G-buffer is not read.
///
/// # Errors
/// [`GpuError::Internal`] for a number of visibility coefficients that no field has.
pub fn preview(
    recorder: &mut Recorder<'_>,
    job: &ShadeJob<'_>,
    source: &PreviewSource<'_>,
    colours: &Buffer<[f32; 4]>,
) -> Result<(), GpuError> {
    use shaders::*;
    let shaders =
        [&PREVIEW_1, &PREVIEW_4, &PREVIEW_9, &PREVIEW_16, &PREVIEW_25, &PREVIEW_36, &PREVIEW_49];
    let shader = by_coefficients(job.n_visibility, shaders)?;
    recorder.stage("preview");
    let rest = vec![
        uniform(source.model),
        source.params.into(),
        source.splats.into(),
        source.rows.into(),
        colours.into(),
    ];
    job.dispatch(recorder, shader, Groups::Linear(source.model.n as usize), rest);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::gpu::shaders::assert_layout;

    #[test]
    fn host_and_shader_agree_on_the_develop_struct() {
        assert_layout!(DevelopUniform as "Develop" in shaders::DEVELOP_1; wanted, depth_scale, infinity, pad);
    }
}
