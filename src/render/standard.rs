//! The standard tier on the CPU engine: split-sum shading from tables, with the light that bounces.

use std::sync::OnceLock;

use crate::engine::channel::{self, Channels, OutgoingRadiance};
use crate::engine::constants::EarlyStop;
use crate::engine::cpu::{
    AttributeSource, Pass, ProbeSettings, Probes, SurfaceShader, Transport, fibonacci_sphere, indirect_basis,
    outward_normals,
};
use crate::light::LightTables;
use crate::render::develop::develop;
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
pub(super) fn render(job: &Job<'_>, shader: &SurfaceShader<'_>) -> Frame {
    let coefficients = job.source.gaussians.width(Field::Visibility);
    let pass = Pass::forward(
        &job.source.under(*shader),
        job.view,
        Channels::Full(coefficients),
        EarlyStop::WhenSaturated,
    );
    develop(&pass, shader, job.outputs, job.depth_scale, |at, surface| match shader.options.shade_at {
        ShadeAt::Pixel => shader.shade(surface).outgoing(),
        ShadeAt::Gaussian => blended(&pass, at),
    })
}

/// Radiance that was blended in pixel (`x`, `y`), of some coverage, of a pass whose Gaussians were shaded before.
pub(super) fn blended(pass: &Pass, (x, y): (usize, usize)) -> OutgoingRadiance {
    let inverse = 1.0 / pass.at(x, y, channel::COVERAGE);
    let at = |first: usize, c: usize| pass.at(x, y, first + c) * inverse;
    let specular = std::array::from_fn(|c| at(OutgoingRadiance::SPECULAR.start, c));
    let diffuse = std::array::from_fn(|c| at(OutgoingRadiance::TOTAL.start, c) - specular[c]);
    OutgoingRadiance { diffuse, specular }
}
