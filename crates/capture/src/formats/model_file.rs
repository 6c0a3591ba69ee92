//! The model file: safetensors with a versioned JSON header.

use std::borrow::Cow;
use std::collections::HashMap;

use safetensors::tensor::{Dtype, SafeTensors, View};
use serde::{Deserialize, Serialize};

use crate::formats::recognise_foreign;
use relume_scene::{
    Field, Framing, Gaussians, IndirectForm, LightSplit, MAX_LIGHTS, Model, ShadeAt, ShadingOptions,
    SplitLight,
};

/// The header version that this build writes. It reads versions 1 to 6.
const VERSION: u32 = 6;
/// Version of models without shadows of the sky in single directions; read unchanged.
const WITHOUT_SKY_SHADOWS: u32 = 5;
/// Version of models without sampling rates, whose diffuse term has the whole light; read unchanged.
const WITHOUT_SAMPLING_RATES: u32 = 4;
/// Version of models without sheen; read unchanged.
const WITHOUT_SHEEN: u32 = 3;
/// Version of models trained with only the diffuse term shaded at the Gaussians; this build shades both terms there.
const DIFFUSE_AT_GAUSSIANS: u32 = 2;
/// Version of models shaded per pixel, whose header does not state it.
const ALL_DEFERRED: u32 = 1;
const HEADER_KEY: &str = "relume";
/// Tensor of the environment of the first light group.
const ENVIRONMENT_KEY: &str = "env_raw";
/// Tensor of the environments of further light groups. Builds that do not know it read the first one.
const OTHER_ENVIRONMENTS_KEY: &str = "env_raw_of_other_groups";
/// Tensor of the lights split off the environment: direction and angular radius.
const LIGHTS_KEY: &str = "lights";
/// Tensor of the share of each texel that belongs to each light.
const SHARES_KEY: &str = "light_shares";

/// Tensor of the confidence of each Gaussian; absent where it was not measured.
const CONFIDENCE_KEY: &str = "confidence";

/// Errors of reading and writing model files.
#[derive(Debug, thiserror::Error)]
pub enum ModelFileError {
    /// The file is not a safetensors file, or is truncated.
    #[error("model file: {0}")]
    Container(#[from] safetensors::SafeTensorError),
    /// A header field or tensor is missing or wrong.
    #[error("model file: {field}: {reason}")]
    Field {
        /// Name of the header field or tensor.
        field: String,
        /// The reason.
        reason: String,
    },
}

#[derive(Serialize, Deserialize)]
struct ModelHeader {
    version: u32,
    gaussians: usize,
    prototypes: usize,
    visibility_order: usize,
    radiance_order: usize,
    env_width: usize,
    env_height: usize,
    /// Number of lights split off the environment; absent for 0.
    #[serde(default, skip_serializing_if = "is_none")]
    lights: usize,
    /// Number of light groups; absent for 1.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    light_groups: usize,
    shading: ShadingOptions,
    world_scale: f64,
    world_offset: [f64; 3],
    /// Absent for captures with masks, and in files of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    framing: Option<Framing>,
    card: serde_json::Value,
}

fn is_none(lights: &usize) -> bool {
    *lights == 0
}

fn one() -> usize {
    1
}

fn is_one(groups: &usize) -> bool {
    *groups == 1
}

/// An f32 tensor that safetensors can serialise.
pub struct Tensor<'a> {
    shape: Vec<usize>,
    data: Cow<'a, [f32]>,
}

impl<'a> Tensor<'a> {
    /// A tensor of `data`, row-major, of `shape`.
    pub fn new(shape: impl Into<Vec<usize>>, data: impl Into<Cow<'a, [f32]>>) -> Self {
        Self { shape: shape.into(), data: data.into() }
    }
}

impl View for Tensor<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(bytemuck::cast_slice(&self.data))
    }
    fn data_len(&self) -> usize {
        std::mem::size_of_val::<[f32]>(&self.data)
    }
}

/// The tensors of a model under their file names, `(name, tensor)`.
pub fn tensors(model: &Model) -> Vec<(String, Tensor<'_>)> {
    let g = &model.gaussians;
    let gaussians = Field::ALL.map(|f| (f.name().to_owned(), Tensor::new([g.len(), g.width(f)], g.field(f))));
    let mut out = Vec::from(gaussians);
    if let Some(confidence) = g.confidence() {
        out.push((CONFIDENCE_KEY.to_owned(), Tensor::new([g.len()], confidence)));
    }
    let prototypes: &[f32] = model.prototypes.as_flattened();
    out.push(("prototypes".to_owned(), Tensor::new([model.prototypes.len(), 3], prototypes)));
    let (first, others) = model.env_raw.split_at(model.env_texels().min(model.env_raw.len()));
    let shape = [model.env_height, model.env_width, 3];
    out.push((ENVIRONMENT_KEY.to_owned(), Tensor::new(shape, first.as_flattened())));
    if !others.is_empty() {
        let shape = [&[model.light_groups() - 1], &shape[..]].concat();
        out.push((OTHER_ENVIRONMENTS_KEY.to_owned(), Tensor::new(shape, others.as_flattened())));
    }
    let LightSplit { lights, shares } = &model.lights;
    if !lights.is_empty() {
        let rows: Vec<f32> = lights.iter().flat_map(|l| [&l.direction[..], &[l.radius]].concat()).collect();
        out.push((LIGHTS_KEY.to_owned(), Tensor::new([lights.len(), 4], rows)));
        out.push((SHARES_KEY.to_owned(), Tensor::new([shares.len(), MAX_LIGHTS], shares.as_flattened())));
    }
    out
}

/// The versioned header of a model, as JSON text.
pub fn header(model: &Model) -> String {
    let g = &model.gaussians;
    let header = ModelHeader {
        version: VERSION,
        gaussians: g.len(),
        prototypes: g.prototypes(),
        visibility_order: g.visibility_degree(),
        radiance_order: g.radiance_degree(),
        env_width: model.env_width,
        env_height: model.env_height,
        lights: model.lights.lights.len(),
        light_groups: model.light_groups(),
        shading: model.shading,
        world_scale: model.world_scale,
        world_offset: model.world_offset.to_array(),
        framing: model.framing,
        card: model.card.clone(),
    };
    serde_json::to_string(&header).unwrap_or_default()
}

/// Floats per Gaussian in the file of `model`.
pub fn floats_a_gaussian(model: &Model) -> usize {
    let stored = Field::ALL.iter().filter(|f| is_stored(**f, model));
    stored.map(|f| model.gaussians.width(*f)).sum()
}

/// True when a model file contains a field; unused fields are left out.
fn is_stored(field: Field, model: &Model) -> bool {
    match field {
        Field::Indirect => model.shading.indirect == IndirectForm::Learned,
        Field::Sheen | Field::SamplingRate => model.gaussians.field(field).iter().any(|v| *v != 0.0),
        _ => true,
    }
}

/// A model as the bytes of one file.
///
/// # Errors
/// If the container library refuses a tensor, which does not happen for a checked model.
pub fn encode(model: &Model) -> Result<Vec<u8>, ModelFileError> {
    let metadata = HashMap::from([(HEADER_KEY.to_owned(), header(model))]);
    let mut tensors = tensors(model);
    for field in Field::ALL.into_iter().filter(|f| !is_stored(*f, model)) {
        tensors.retain(|(name, _)| name != field.name());
    }
    Ok(safetensors::serialize(tensors, Some(metadata))?)
}

/// Reads a model back and checks it.
///
/// # Errors
/// Names the header field or tensor that is missing, of another length, or not finite.
pub fn decode(bytes: &[u8]) -> Result<Model, ModelFileError> {
    let bad = |field: &str, reason: String| ModelFileError::Field { field: field.to_owned(), reason };
    if let Some(what) = recognise_foreign(bytes) {
        return Err(bad("file", what.to_owned()));
    }
    let (_, metadata) = SafeTensors::read_metadata(bytes)?;
    let text = metadata.metadata().as_ref().and_then(|m| m.get(HEADER_KEY));
    let text = text.ok_or_else(|| bad("header", "is missing: this is not a Relume model".into()))?;
    let mut header: ModelHeader = serde_json::from_str(text).map_err(|e| bad("header", e.to_string()))?;
    match header.version {
        VERSION | WITHOUT_SKY_SHADOWS | WITHOUT_SAMPLING_RATES | WITHOUT_SHEEN | DIFFUSE_AT_GAUSSIANS => {}
        ALL_DEFERRED => header.shading.shade_at = ShadeAt::Pixel,
        other => {
            return Err(bad("version", format!("is {other}; this build reads {ALL_DEFERRED} to {VERSION}")));
        }
    }
    let file = SafeTensors::deserialize(bytes)?;
    if header.visibility_order > 8 || header.radiance_order > 4 {
        return Err(bad("visibility_order,radiance_order", "must be at most 8 and 4".into()));
    }
    // Sizes are checked against the file's length before memory is allocated for them.
    if header.gaussians.saturating_mul(3 * 4) > bytes.len() {
        return Err(bad("gaussians", "states more Gaussians than the file contains".into()));
    }
    if header.prototypes > 4096 {
        return Err(bad("prototypes", "must be at most 4096".into()));
    }
    let mut gaussians = Gaussians::zeroed(
        header.gaussians,
        header.prototypes,
        header.visibility_order,
        header.radiance_order,
    );
    let is_required = |field: Field| match field {
        Field::Indirect => header.shading.indirect == IndirectForm::Learned,
        Field::Sheen | Field::SamplingRate => false,
        _ => true,
    };
    let present = |field: Field| is_required(field) || file.tensor(field.name()).is_ok();
    for (field, _, data) in gaussians.fields_mut().filter(|(field, ..)| present(*field)) {
        *data = floats(&file, field.name(), data.len())?;
    }
    if file.tensor(CONFIDENCE_KEY).is_ok() {
        let count = gaussians.len();
        gaussians.set_confidence(floats(&file, CONFIDENCE_KEY, count)?);
    }
    let triples = |name: &str, count: usize| -> Result<Vec<[f32; 3]>, ModelFileError> {
        let flat = floats(&file, name, count.saturating_mul(3))?;
        Ok(flat.as_chunks::<3>().0.to_vec())
    };
    let texels = header.env_width.saturating_mul(header.env_height);
    let mut environments = triples(ENVIRONMENT_KEY, texels)?;
    if header.light_groups > 1 {
        environments.extend(triples(OTHER_ENVIRONMENTS_KEY, texels.saturating_mul(header.light_groups - 1))?);
    }
    let model = Model {
        prototypes: triples("prototypes", header.prototypes)?,
        env_raw: environments,
        gaussians,
        env_width: header.env_width,
        env_height: header.env_height,
        lights: split(&file, header.lights, texels)?,
        shading: header.shading,
        world_scale: header.world_scale,
        world_offset: header.world_offset.into(),
        framing: header.framing,
        card: header.card,
    };
    model.check().map_err(|e| bad(e.field, e.reason))?;
    Ok(model)
}

/// Reads the lights split off an environment of `texels` texels.
fn split(file: &SafeTensors<'_>, lights: usize, texels: usize) -> Result<LightSplit, ModelFileError> {
    if lights == 0 {
        return Ok(LightSplit::default());
    }
    let rows = floats(file, LIGHTS_KEY, lights.saturating_mul(4))?;
    let shares = floats(file, SHARES_KEY, texels.saturating_mul(MAX_LIGHTS))?;
    let light = |&[x, y, z, radius]: &[f32; 4]| SplitLight { direction: [x, y, z], radius };
    Ok(LightSplit {
        lights: rows.as_chunks::<4>().0.iter().map(light).collect(),
        shares: shares.as_chunks::<MAX_LIGHTS>().0.to_vec(),
    })
}

/// Tensor `name` as `count` floats.
pub fn floats(file: &SafeTensors<'_>, name: &str, count: usize) -> Result<Vec<f32>, ModelFileError> {
    let bad = |reason: String| ModelFileError::Field { field: name.to_owned(), reason };
    let tensor = file.tensor(name).map_err(|_| bad("is missing".into()))?;
    if tensor.dtype() != Dtype::F32 || tensor.data().len() != count.saturating_mul(4) {
        return Err(bad(format!("must be {count} f32 values")));
    }
    let chunks = tensor.data().as_chunks::<4>().0;
    Ok(chunks.iter().map(|b| f32::from_le_bytes(*b)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Model {
        let mut gaussians = Gaussians::zeroed(3, 2, 1, 0);
        gaussians
            .fields_mut()
            .for_each(|(_, _, d)| d.iter_mut().enumerate().for_each(|(i, v)| *v = i as f32));
        Model {
            gaussians,
            prototypes: vec![[0.1; 3]; 2],
            env_raw: vec![[0.2; 3]; 8],
            env_width: 4,
            env_height: 2,
            lights: Default::default(),
            shading: ShadingOptions::default(),
            world_scale: 2.0,
            world_offset: glam::DVec3::X,
            framing: None,
            card: serde_json::json!({"seed": 3}),
        }
    }

    #[test]
    fn model_round_trips_through_its_file() {
        let mut model = example();
        model.shading.indirect = IndirectForm::Learned;
        assert_eq!(decode(&encode(&model).unwrap()).unwrap(), model);
        let framing = Framing { eye: glam::DVec3::X, target: glam::DVec3::ZERO, fov_deg: 40.0 };
        model.framing = Some(framing);
        assert_eq!(decode(&encode(&model).unwrap()).unwrap(), model);
        model.framing = Some(Framing { eye: framing.target, ..framing });
        let refused = decode(&encode(&model).unwrap()).map(|_| ()).unwrap_err();
        assert!(refused.to_string().contains("framing"), "{refused}");
    }

    #[test]
    fn confidence_is_stored_and_checked() {
        let mut model = example();
        model.gaussians.set_confidence(vec![0.0, 0.5, 1.0]);
        assert_eq!(
            decode(&encode(&model).unwrap()).unwrap().gaussians.confidence(),
            Some(&[0.0, 0.5, 1.0][..])
        );
        for bad in [-0.1, 1.5, f32::NAN] {
            model.gaussians.set_confidence(vec![0.5, bad, 0.5]);
            let refused = decode(&encode(&model).unwrap()).map(|_| ()).unwrap_err();
            assert!(refused.to_string().contains("confidence"), "{refused}");
        }
        assert_eq!(decode(&encode(&example()).unwrap()).unwrap().gaussians.confidence(), None, "the control");
    }

    #[test]
    fn unused_weights_are_not_stored() {
        let mut model = example();
        model.shading.indirect = IndirectForm::Learned;
        let whole = encode(&model).unwrap().len();
        model.shading.indirect = IndirectForm::Gathered;
        let bytes = encode(&model).unwrap();
        assert!(bytes.len() + model.gaussians.len() * 16 * 4 <= whole);
        model.gaussians.field_mut(Field::Indirect).fill(0.0);
        assert_eq!(decode(&bytes).unwrap(), model);
        // The control: decoding refuses a file that requires the weights but lacks them.
        model.shading.indirect = IndirectForm::Learned;
        let metadata = HashMap::from([(HEADER_KEY.to_owned(), header(&model))]);
        let mut without = tensors(&model);
        without.retain(|(name, _)| name != "ind_sh");
        let err = decode(&safetensors::serialize(without, Some(metadata)).unwrap()).unwrap_err();
        assert!(err.to_string().contains("ind_sh"), "{err}");
    }

    #[test]
    fn files_of_earlier_versions_are_read() {
        let at = |version: u32, shade_at: &str| {
            let mut model = example();
            model.shading.shade_at = ShadeAt::Gaussian;
            let text =
                header(&model).replace(&format!("\"version\":{VERSION}"), &format!("\"version\":{version}"));
            let text = text.replace("\"shade_at\":\"gaussian\",", shade_at);
            let text = if version < VERSION { text.replace("\"sky_shadows\":true,", "") } else { text };
            let metadata = HashMap::from([(HEADER_KEY.to_owned(), text)]);
            decode(&safetensors::serialize(tensors(&model), Some(metadata)).unwrap())
        };
        let read = |version, shade_at| at(version, shade_at).unwrap().shading.shade_at;
        assert_eq!(read(1, ""), ShadeAt::Pixel);
        assert_eq!(read(2, "\"diffuse_at\":\"gaussian\","), ShadeAt::Gaussian);
        assert_eq!(read(2, "\"diffuse_at\":\"pixel\","), ShadeAt::Pixel);
        assert_eq!(read(3, "\"shade_at\":\"pixel\","), ShadeAt::Pixel, "the control");
        assert_eq!(read(4, "\"shade_at\":\"pixel\","), ShadeAt::Pixel);
        let sky_shadows = |version| at(version, "\"shade_at\":\"gaussian\",").unwrap().shading.sky_shadows;
        assert!(!sky_shadows(5), "older models look as before");
        assert!(sky_shadows(VERSION), "the control");
        assert!(at(VERSION + 1, "").unwrap_err().to_string().contains("version"));
    }

    #[test]
    fn sheen_is_stored_only_if_any_is_not_zero() {
        let mut model = example();
        model.shading.indirect = IndirectForm::Learned;
        let (with, floats) = (encode(&model).unwrap(), floats_a_gaussian(&model));
        model.gaussians.field_mut(Field::Sheen).fill(0.0);
        let without = encode(&model).unwrap();
        assert!(without.len() + model.gaussians.len() * 4 <= with.len());
        assert_eq!(floats_a_gaussian(&model), floats - 1);
        assert_eq!(decode(&without).unwrap(), model);
    }

    #[test]
    fn lights_are_stored_only_if_the_model_has_any() {
        let mut model = example();
        model.gaussians.field_mut(Field::Indirect).fill(0.0);
        let without = encode(&model).unwrap();
        assert!(
            !String::from_utf8_lossy(&without).contains("lights"),
            "files without lights have no such tensors"
        );
        let light = SplitLight { direction: [0.0, 0.6, 0.8], radius: 0.01 };
        model.lights = LightSplit { lights: vec![light; 2], shares: vec![[0.5, 0.25, 0.0, 0.0]; 8] };
        assert_eq!(decode(&encode(&model).unwrap()).unwrap(), model);
        model.lights.shares[3][1] = 0.75;
        let err = decode(&encode(&model).unwrap()).unwrap_err();
        assert!(err.to_string().contains("lights"), "{err}");
    }

    #[test]
    fn truncated_files_and_nan_values_are_refused() {
        let bytes = encode(&example()).unwrap();
        for cut in [0, 7, 40, bytes.len() - 1] {
            assert!(decode(&bytes[..cut]).is_err(), "cut at {cut}");
        }
        let mut model = example();
        model.gaussians.field_mut(Field::Mean)[0] = f32::NAN;
        let err = decode(&encode(&model).unwrap()).unwrap_err();
        assert!(err.to_string().contains("means"), "{err}");
    }
}
