//! The standard tier on the CPU engine: split-sum shading from tables, with the light that bounces.

use std::sync::OnceLock;

use crate::engine::channel::Channels;
use crate::engine::cpu::{AttributeSource, Pass, Probes, Shader, Surface, Transport, outward_normals};
use crate::engine::{ProbeSettings, fibonacci_sphere, indirect_basis};
use crate::light::LightTables;
use crate::render::develop::{Lit, develop};
use crate::render::{Frame, Job};
use crate::scene::{Field, IndirectForm, ShadeAt};

/// Probe directions behind the gathered light of a render.
pub(super) const PROBE_DIRECTIONS: usize = 96;
/// Rounds of gathered light.
pub(super) const BOUNCES: usize = 3;

/// A light as the CPU engine shades with it.
pub(super) struct LightOnCpu {
    pub(super) tables: LightTables,
    /// Irradiance and mean blocked radiance that a model's surfaces send each other.
    pub(super) gathered: Vec<[f32; 6]>,
    pub(super) indirect_basis: [[f32; 3]; 16],
}

impl LightOnCpu {
    /// `transport` is measured when it was not yet: it does not depend on the light. `source` carries no gathered light.
    pub(super) fn new(
        source: &AttributeSource<'_>,
        transport: &OnceLock<Transport>,
        tables: LightTables,
    ) -> Self {
        let mut gathered = Vec::new();
        if source.options.indirect == IndirectForm::Gathered {
            let transport = transport.get_or_init(|| {
                let directions = fibonacci_sphere(PROBE_DIRECTIONS);
                let probes = Probes::measure(source, directions, ProbeSettings::of(source.options));
                Transport::new(&probes, outward_normals(source))
            });
            gathered = transport.gather(source, &tables, BOUNCES);
        }
        let indirect_basis = indirect_basis(&tables);
        Self { tables, gathered, indirect_basis }
    }
}

/// Renders every pixel under the tables of `shader`.
pub(super) fn render(job: &Job<'_>, shader: &Shader<'_>) -> Frame {
    let coefficients = job.source.gaussians.width(Field::Visibility);
    let pass = Pass::forward(&job.source.under(*shader), job.view, Channels::Full(coefficients), true);
    develop(&pass, shader, job.outputs, job.depth_scale, |_, surface| shade(shader, surface))
}

/// One pixel of a pass under `shader`.
fn shade(shader: &Shader<'_>, surface: &Surface) -> Lit {
    match shader.options.shade_at {
        ShadeAt::Pixel => shade_here(shader, surface),
        ShadeAt::Gaussian => blended(surface),
    }
}

/// One pixel of an unlit pass, from the tables.
pub(super) fn shade_here(shader: &Shader<'_>, surface: &Surface) -> Lit {
    let shaded = shader.shade(surface);
    Lit { diffuse: shaded.diffuse, specular: shaded.specular }
}

/// One pixel of a lit pass, whose light is in the channels that shading in the pixel has other use for.
pub(super) fn blended(surface: &Surface) -> Lit {
    let Surface { gathered: light, indirect: specular, .. } = *surface;
    Lit { diffuse: std::array::from_fn(|c| light[c] - specular[c]), specular }
}
