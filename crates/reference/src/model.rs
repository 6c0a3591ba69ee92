//! The model of the reference engine: raw parameters by name, in f64.

use std::collections::BTreeMap;

use super::array::Array;
use super::tape::{Tape, TapeGradients, Var};
use relume_scene::{Field, Model};

/// Name of the prototype table parameter, (K, 3).
pub const PROTOTYPES: &str = "prototypes";
/// Name of the raw environment parameter, (rows, columns, 3), before softplus.
pub const ENVIRONMENT: &str = "env_raw";

/// Arrays by parameter name ([`Field::name`], [`PROTOTYPES`], [`ENVIRONMENT`]).
pub type Arrays = BTreeMap<&'static str, Array>;

/// Raw parameters before activation, complete and with consistent shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceModel {
    arrays: Arrays,
}

/// A parameter that is missing or has the wrong shape.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name}: {reason}")]
pub struct ReferenceModelError {
    /// Name of the parameter.
    pub name: &'static str,
    /// The reason.
    pub reason: String,
}

/// Every parameter name, per-Gaussian ones first.
pub fn parameter_names() -> impl Iterator<Item = &'static str> {
    Field::ALL.into_iter().map(Field::name).chain([PROTOTYPES, ENVIRONMENT])
}

impl ReferenceModel {
    /// A model from arrays by name. A missing `radiance_sh` means black, a missing `sheen` means no sheen, a missing
    /// `sampling_rate` an unknown one.
    ///
    /// # Errors
    /// Names the first parameter that is missing or inconsistent with the others.
    pub fn new(mut arrays: Arrays) -> Result<Self, ReferenceModelError> {
        let count = arrays.get(Field::Mean.name()).map_or(0, |a| a.shape()[0]);
        arrays.entry(Field::Radiance.name()).or_insert_with(|| Array::zeros(&[count, 3]));
        arrays.entry(Field::Sheen.name()).or_insert_with(|| Array::zeros(&[count, 1]));
        arrays.entry(Field::SamplingRate.name()).or_insert_with(|| Array::zeros(&[count, 1]));
        for name in parameter_names() {
            let Some(array) = arrays.get(name) else {
                return Err(ReferenceModelError { name, reason: "is missing".into() });
            };
            let fits = match (name, array.shape()) {
                (PROTOTYPES, shape) => shape.len() == 2 && shape[1] == 3,
                (ENVIRONMENT, shape) => shape.len() == 3 && shape[2] == 3,
                (_, shape) => shape.len() == 2 && shape[0] == count,
            };
            if !fits {
                return Err(ReferenceModelError {
                    name,
                    reason: format!("has the shape {:?}", array.shape()),
                });
            }
        }
        Ok(Self { arrays })
    }

    /// The parameters of a model, widened to f64.
    pub fn from_model(model: &Model) -> Self {
        let wide =
            |shape: &[usize], data: &[f32]| Array::new(shape, data.iter().map(|&v| v.into()).collect());
        let g = &model.gaussians;
        let mut arrays: Arrays =
            Field::ALL.into_iter().map(|f| (f.name(), wide(&[g.len(), g.width(f)], g.field(f)))).collect();
        let prototypes = wide(&[model.prototypes.len(), 3], model.prototypes.as_flattened());
        arrays.insert(PROTOTYPES, prototypes);
        let size = [model.env_height, model.env_width, 3];
        arrays.insert(ENVIRONMENT, wide(&size, model.env_raw.as_flattened()));
        Self { arrays }
    }

    /// The array of a parameter.
    ///
    /// # Panics
    /// When `name` is not one of [`parameter_names`].
    pub fn array(&self, name: &str) -> &Array {
        &self.arrays[name]
    }

    /// The values of a parameter, mutable.
    pub fn values_mut(&mut self, name: &str) -> Option<&mut [f64]> {
        self.arrays.get_mut(name).map(Array::data_mut)
    }
}

/// The parameters of a scene as inputs of one tape.
pub struct Parameters<'t> {
    vars: BTreeMap<&'static str, Var<'t>>,
}

impl<'t> Parameters<'t> {
    /// Puts every parameter on the tape.
    pub fn new(tape: &'t Tape, scene: &ReferenceModel) -> Self {
        Self { vars: scene.arrays.iter().map(|(&name, a)| (name, tape.input(a.clone()))).collect() }
    }

    /// A per-Gaussian parameter.
    pub fn get(&self, field: Field) -> Var<'t> {
        self.vars[field.name()]
    }

    /// The prototype colours clamped to [0, 1], (K, 3).
    pub fn prototypes(&self) -> Var<'t> {
        self.vars[PROTOTYPES].clamp(0.0, 1.0)
    }

    /// The environment's radiance, (texels, 3): softplus of the raw values.
    pub fn environment(&self) -> Var<'t> {
        let raw = self.vars[ENVIRONMENT];
        let texels = raw.value().len() / 3;
        raw.softplus().reshaped(&[texels, 3])
    }

    /// Rows and columns of the environment.
    pub fn environment_size(&self) -> [usize; 2] {
        let raw = self.vars[ENVIRONMENT].value();
        [raw.shape()[0], raw.shape()[1]]
    }

    /// Soft assignment of each Gaussian to the prototypes, (N, K).
    pub fn assignment(&self) -> Var<'t> {
        self.get(Field::ProtoLogits).softmax()
    }

    /// Albedo of each Gaussian, (N, 3): `a = sum_k p_k A_k + eps`, in [0, 1] (Eq. 23).
    pub fn albedo(&self) -> Var<'t> {
        (self.assignment().matmul(self.prototypes()) + self.get(Field::Residual)).clamp(0.0, 1.0)
    }

    /// Gradients with respect to every parameter.
    pub fn gradients(&self, found: &TapeGradients) -> Arrays {
        self.vars.iter().map(|(&name, &var)| (name, found.of(var))).collect()
    }
}
