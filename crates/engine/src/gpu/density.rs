//! Density control on the device: the host plans from a few floats per Gaussian; the model stays in device memory.

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::density::{DensityPlan, DensitySignals, DensityStats, PlannedGaussian, SplitOrigin};
use crate::gpu::model::ModelBuffers;
use crate::gpu::{Buffer, Gpu, Groups, Recorder, shaders, uniform};
use relume_scene::Field;

/// One new Gaussian; `plan` of `shaders/density_gather.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
struct PlanEntry {
    source: u32,
    origin: u32,
}

impl PlanEntry {
    fn new(planned: &PlannedGaussian) -> Self {
        let origin = match planned.origin {
            SplitOrigin::Keep => 0,
            SplitOrigin::UpperHalf => 2,
            SplitOrigin::LowerHalf => 3,
        };
        Self { source: planned.source, origin }
    }
}

/// Rows to copy; `rows` of `shaders/inherit_rows.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
struct InheritedRows {
    n_values: u32,
    width: u32,
    old_start: u32,
    new_start: u32,
}

/// A plan in device memory.
pub struct UploadedPlan {
    entries: Buffer<PlanEntry>,
    /// Number of Gaussians of the old generation.
    before: u32,
}

impl UploadedPlan {
    /// Uploads a plan for `before` Gaussians.
    ///
    /// # Errors
    /// When the device has no memory, or a source of the plan does not exist.
    pub fn new(gpu: &Gpu, plan: &DensityPlan, before: u32) -> Result<Self, DeviceError> {
        if let Some(planned) = plan.gaussians.iter().find(|p| p.source >= before) {
            return Err(DeviceError::Misuse(format!("density: source {} of {before}", planned.source)));
        }
        let entries: Vec<PlanEntry> = plan.gaussians.iter().map(PlanEntry::new).collect();
        Ok(Self { entries: gpu.upload("density plan", &entries)?, before })
    }
}

/// Reads the signals of density control: 9 floats per Gaussian.
///
/// # Errors
/// Errors of the device.
pub fn read_signals(
    gpu: &Gpu,
    model: &ModelBuffers,
    stats: &Buffer<[f32; 2]>,
) -> Result<DensitySignals, DeviceError> {
    let (n, layout) = (model.len(), &model.layout);
    let vectors = |field: Field| -> Result<Vec<[f32; 3]>, DeviceError> {
        let start = layout.start(field);
        Ok(bytemuck::cast_slice(&gpu.read(&model.params, start..start + 3 * n)?).to_vec())
    };
    let opacity = layout.start(Field::OpacityLogit);
    Ok(DensitySignals {
        means: vectors(Field::Mean)?,
        log_scales: vectors(Field::LogScale)?,
        opacity_logits: gpu.read(&model.params, opacity..opacity + n)?,
        stats: read_stats(gpu, stats)?,
    })
}

/// The statistics since the last round.
///
/// # Errors
/// Errors of the device.
pub fn read_stats(gpu: &Gpu, stats: &Buffer<[f32; 2]>) -> Result<DensityStats, DeviceError> {
    let (absgrad, seen) = gpu.read(stats, 0..stats.len())?.iter().map(|s| (s[0], s[1])).unzip();
    Ok(DensityStats { absgrad, seen })
}

/// `old` after a round of density control, in new buffers; prototypes and light are shared with `old`. Measurements and statistics belong
/// to the old Gaussians: the caller must inherit ([`inherit`]) or clear them.
///
/// # Errors
/// When the device has no memory for both.
pub fn gather(
    recorder: &mut Recorder<'_>,
    old: &ModelBuffers,
    plan: &UploadedPlan,
) -> Result<ModelBuffers, DeviceError> {
    let gpu = recorder.gpu();
    let layout = old.layout.resized(plan.entries.len() as u32);
    let floats = layout.floats();
    let out = ModelBuffers {
        layout,
        params: gpu.buffer("the Gaussians", floats)?,
        first: gpu.buffer("first moments", floats)?,
        second: gpu.buffer("second moments", floats)?,
        ..old.clone()
    };
    let bindings = [
        uniform(&old.layout),
        uniform(&layout),
        (&plan.entries).into(),
        (&old.params).into(),
        (&old.first).into(),
        (&old.second).into(),
        (&out.params).into(),
        (&out.first).into(),
        (&out.second).into(),
    ];
    recorder.stage("density");
    recorder.dispatch(&shaders::DENSITY_GATHER, Groups::Linear(floats), &bindings);
    Ok(out)
}

/// Measurements after a round of density control: each new Gaussian has those of its source. `old` has one block of rows for each of
/// `widths`, a row of that many values for each Gaussian.
///
/// # Errors
/// When the device has no memory for both.
pub fn inherit(
    recorder: &mut Recorder<'_>,
    old: &Buffer<f32>,
    widths: &[usize],
    plan: &UploadedPlan,
) -> Result<Buffer<f32>, DeviceError> {
    let after = plan.entries.len();
    let new = recorder.gpu().buffer("measurements", after * widths.iter().sum::<usize>())?;
    let (mut old_start, mut new_start) = (0, 0);
    recorder.stage("density");
    for &width in widths {
        let n_values = after as u32 * width as u32;
        let rows = InheritedRows { n_values, width: width as u32, old_start, new_start };
        let bindings = [uniform(&rows), (&plan.entries).into(), old.into(), (&new).into()];
        recorder.dispatch(&shaders::INHERIT_ROWS, Groups::Linear(n_values as usize), &bindings);
        old_start += plan.before * width as u32;
        new_start += n_values;
    }
    Ok(new)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::rotation;
    use crate::gpu::shaders::assert_layout;
    use crate::sigmoid;
    use relume_compare::{largest_difference, worst};
    use relume_scene::{EnvMap, Field, Gaussians, Model};

    fn model(n: usize) -> Model {
        let mut gaussians = Gaussians::zeroed(n, 5, 2, 1);
        let mut next = 0u32;
        for (_, _, data) in gaussians.fields_mut() {
            for v in data {
                next = next.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *v = (next >> 8) as f32 / (1 << 23) as f32 - 1.0;
            }
        }
        let env = EnvMap::constant(4, 2, [0.5; 3]);
        Model::new(gaussians, vec![[0.2, 0.4, 0.6]; 5], env.texels().to_vec(), (4, 2))
    }

    /// The rule of halving, as in the CPU engine's `density`.
    fn halve(g: &mut Gaussians, i: usize, side: f32) {
        let scale: [f32; 3] = g.get(Field::LogScale, i);
        let axis = (0..3).rev().fold(0, |a, k| if scale[k] >= scale[a] { k } else { a });
        let q = rotation(g.get(Field::Quaternion, i));
        for r in 0..3 {
            g.row_mut(Field::Mean, i)[r] += side * 0.5 * scale[axis].exp() * q[r][axis];
            g.row_mut(Field::LogScale, i)[r] += if r == axis { 0.55f32.ln() } else { 0.9f32.ln() };
        }
        let opacity = &mut g.row_mut(Field::OpacityLogit, i)[0];
        let halved = (1.0 - (1.0 - sigmoid(*opacity)).powf(0.7)).clamp(0.01, 0.98);
        *opacity = (halved / (1.0 - halved)).ln();
    }

    /// A round that keeps `keep` in order and splits the Gaussians for which `is_split` is true: the first half replaces its
    /// source, the second halves follow at the end.
    fn plan(keep: &[u32], is_split: impl Fn(u32) -> bool) -> DensityPlan {
        let first = |i: u32| if is_split(i) { SplitOrigin::UpperHalf } else { SplitOrigin::Keep };
        let kept = keep.iter().map(|&source| PlannedGaussian { source, origin: first(source) });
        let second = keep.iter().filter(|i| is_split(**i));
        let second = second.map(|&source| PlannedGaussian { source, origin: SplitOrigin::LowerHalf });
        DensityPlan { gaussians: kept.chain(second).collect() }
    }

    /// Largest difference over all fields.
    fn apart(a: &Gaussians, b: &Gaussians) -> f64 {
        worst(Field::ALL.map(|f| largest_difference(a.field(f), b.field(f))))
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn density_round_on_the_gpu_matches_the_host() {
        let gpu = Gpu::for_tests();
        for n in [1usize, 7, 300] {
            let mut model = model(n);
            // A tie of the longest axis, an opaque and a faint Gaussian.
            model.gaussians.row_mut(Field::LogScale, 0).fill(0.25);
            model.gaussians.row_mut(Field::OpacityLogit, 0)[0] = 12.0;
            model.gaussians.row_mut(Field::OpacityLogit, n - 1)[0] = -9.0;
            let old = ModelBuffers::upload(&gpu, &model).unwrap();
            gpu.write(&old.first, 0, &crate::gpu::model::planar(&model.gaussians));
            let keep: Vec<u32> = (0..n as u32).filter(|i| i % 3 != 1).collect();
            let is_split = |i: u32| i.is_multiple_of(4);
            let plan = plan(&keep, is_split);
            let mut recorder = gpu.record();
            let uploaded = UploadedPlan::new(&gpu, &plan, n as u32).unwrap();
            let new = gather(&mut recorder, &old, &uploaded).unwrap();
            recorder.submit().unwrap();

            let seconds: Vec<u32> = keep.iter().copied().filter(|i| is_split(*i)).collect();
            let indices: Vec<usize> = keep.iter().chain(&seconds).map(|i| *i as usize).collect();
            let mut expected = model.gaussians.gathered(&indices);
            let plain = expected.clone();
            let mut first = expected.clone();
            for (at, i) in indices.iter().enumerate().filter(|(_, i)| is_split(**i as u32)) {
                halve(&mut expected, at, if at < keep.len() { 1.0 } else { -1.0 });
                for (_, width, data) in first.fields_mut() {
                    data[at * width..(at + 1) * width].fill(0.0);
                }
                assert!(*i < n);
            }
            let params = new.read_gaussians(&gpu, &new.params, &model.gaussians).unwrap();
            assert!(apart(&params, &expected) < 3e-6, "{n}: {}", apart(&params, &expected));
            assert!(apart(&params, &plain) > 0.1, "the control: halves differ from wholes");
            let moments = new.read_gaussians(&gpu, &new.first, &model.gaussians).unwrap();
            assert_eq!(apart(&moments, &first), 0.0);
            let seconds = new.read_gaussians(&gpu, &new.second, &model.gaussians).unwrap();
            assert!(Field::ALL.iter().all(|f| seconds.field(*f).iter().all(|v| *v == 0.0)));
            assert_eq!(new.read_globals(&gpu, &new.globals).unwrap()[0], model.prototypes);
        }
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn empty_density_plan_is_valid_and_unknown_sources_are_refused() {
        let gpu = Gpu::for_tests();
        let old = ModelBuffers::upload(&gpu, &model(3)).unwrap();
        let mut recorder = gpu.record();
        let empty = UploadedPlan::new(&gpu, &DensityPlan::default(), 3).unwrap();
        assert!(gather(&mut recorder, &old, &empty).unwrap().is_empty());
        assert_eq!(
            inherit(&mut recorder, &gpu.upload("rows", &[1.0; 3]).unwrap(), &[1], &empty).unwrap().len(),
            0
        );
        assert!(UploadedPlan::new(&gpu, &plan(&[3], |_| false), 3).is_err());
        recorder.submit().unwrap();
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn new_gaussians_have_the_measurements_of_their_sources() {
        let gpu = Gpu::for_tests();
        assert_layout!(InheritedRows as "InheritedRows" in shaders::INHERIT_ROWS; n_values, width, old_start, new_start);
        for n in [1usize, 7, 300] {
            let keep: Vec<u32> = (0..n as u32).filter(|i| i % 3 != 1).collect();
            let plan = plan(&keep, |i| i.is_multiple_of(4));
            let values: Vec<f32> = (0..n * 10).map(|v| v as f32).collect();
            let old = gpu.upload("rows", &values).unwrap();
            let uploaded = UploadedPlan::new(&gpu, &plan, n as u32).unwrap();
            let mut recorder = gpu.record();
            let new = inherit(&mut recorder, &old, &[6, 4], &uploaded).unwrap();
            recorder.submit().unwrap();
            let sources = || plan.gaussians.iter().map(|g| g.source as usize);
            let six = sources().flat_map(|i| values[i * 6..(i + 1) * 6].to_vec());
            let four = sources().flat_map(|i| values[n * 6 + i * 4..n * 6 + (i + 1) * 4].to_vec());
            assert_eq!(gpu.read(&new, 0..new.len()).unwrap(), six.chain(four).collect::<Vec<_>>(), "{n}");
        }
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn density_signals_equal_the_model_values() {
        let gpu = Gpu::for_tests();
        let model = model(9);
        let buffers = ModelBuffers::upload(&gpu, &model).unwrap();
        let stats: Vec<[f32; 2]> = (0..9).map(|i| [i as f32, 2.0]).collect();
        let signals = read_signals(&gpu, &buffers, &gpu.upload("stats", &stats).unwrap()).unwrap();
        let g = &model.gaussians;
        assert_eq!(signals.means[8], g.get::<3>(Field::Mean, 8));
        assert_eq!(signals.log_scales[8], g.get::<3>(Field::LogScale, 8));
        assert_eq!(signals.opacity_logits, g.field(Field::OpacityLogit));
        assert_eq!(signals.stats.absgrad, (0..9).map(|i| i as f32).collect::<Vec<_>>());
        assert_eq!(signals.stats.seen, [2.0; 9]);
    }
}
