//! The world of an imported model: scale, offset and normals.

use glam::{DVec3, Vec3};

use crate::formats::splats::outward_axis;
use relume_scene::{Field, Gaussians, Model, NormalForm};

/// Share of the Gaussians that the unit ball of the world contains, for files that do not state the scale of the
/// world.
const HELD: f64 = 0.98;

/// Size of a Gaussian, relative to the radius of the model, above which it is huge.
const HUGE: f64 = 10.0;

/// The ball that contains most Gaussians.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    /// The median of the centres of the Gaussians.
    centre: DVec3,
    /// The distance from the centre within which [`HELD`] of the Gaussians lie; `None` if it is 0.
    radius: Option<f64>,
}

/// The extent of Gaussians in their own units, without regard to the few that lie far away.
pub(super) fn extent(gaussians: &Gaussians) -> Extent {
    let centres = || gaussians.field(Field::Mean).as_chunks::<3>().0.iter();
    let at_share = |mut values: Vec<f64>, share: f64| {
        values.sort_by(f64::total_cmp);
        values.get(((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1))).copied()
    };
    let median = |axis: usize| at_share(centres().map(|c| f64::from(c[axis])).collect(), 0.5).unwrap_or(0.0);
    let centre = DVec3::new(median(0), median(1), median(2));
    let distance = |c: &[f32; 3]| (DVec3::from(c.map(f64::from)) - centre).length();
    Extent { centre, radius: at_share(centres().map(distance).collect(), HELD).filter(|r| *r > 0.0) }
}

impl Extent {
    /// Scale and offset of a world that is this ball.
    pub(super) fn world(&self) -> (f64, DVec3) {
        (1.0 / self.radius.unwrap_or(1.0), -self.centre)
    }

    /// A note on Gaussians whose largest standard deviation is more than [`HUGE`] times the radius. `row_of` gives the vertex of
    /// a Gaussian.
    pub(super) fn huge(
        &self,
        gaussians: &Gaussians,
        row_of: impl Fn(usize) -> Option<usize>,
    ) -> Option<String> {
        let limit = HUGE * self.radius?;
        let sizes = gaussians.field(Field::LogScale).as_chunks::<3>().0.iter();
        let largest = sizes.map(|log| f64::from(log.iter().copied().fold(f32::NEG_INFINITY, f32::max)).exp());
        let huge: Vec<usize> =
            largest.enumerate().filter(|(_, size)| *size > limit).map(|(i, _)| i).collect();
        let first = row_of(*huge.first()?)?;
        Some(format!(
            "{} of {} splats are larger than {HUGE} times the radius of the model (standard deviations above {limit:.2e} units), and may \
             cover the whole picture; if they are errors, remove them in the program that wrote the file; the first is vertex {first}",
            huge.len(),
            gaussians.len()
        ))
    }
}

/// Converts the Gaussians from capture units to the world of `model`.
pub(super) fn into_world(model: &mut Model) {
    let (scale, offset) = (model.world_scale, model.world_offset);
    for centre in model.gaussians.field_mut(Field::Mean).as_chunks_mut::<3>().0 {
        *centre = ((DVec3::from(centre.map(f64::from)) + offset) * scale).as_vec3().to_array();
    }
    let grow = scale.ln() as f32;
    model.gaussians.field_mut(Field::LogScale).iter_mut().for_each(|s| *s += grow);
    let rates = model.gaussians.field_mut(Field::SamplingRate);
    rates.iter_mut().for_each(|rate| *rate = (f64::from(*rate) / scale) as f32);
}

/// Sets the normal field so that the shading normal, seen from outside, is `unit`. A vector that is not finite counts as
/// zero.
pub(super) fn set_normal(model: &mut Model, i: usize, unit: [f32; 3]) {
    let unit = Vec3::from(unit).normalize_or_zero();
    let own = match model.shading.normal {
        NormalForm::Free => unit,
        NormalForm::ShortestAxis if unit == Vec3::ZERO => Vec3::ZERO,
        NormalForm::ShortestAxis => unit - outward_axis(model, i),
    };
    model.gaussians.row_mut(Field::Normal, i).copy_from_slice(&own.to_array());
}
