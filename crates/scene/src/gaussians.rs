//! The Gaussians of a model: one flat array per parameter, so that optimiser, density control and files treat all
//! parameters in the same way.

use relume_layout::{Field, FieldWidth};

/// Number of real SH coefficients up to degree `sh_degree`.
pub const fn sh_count(sh_degree: usize) -> usize {
    (sh_degree + 1) * (sh_degree + 1)
}

/// N Gaussians as arrays of raw (pre-activation) parameters, `field(f)[i * width(f) ..][.. width(f)]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussians {
    len: usize,
    prototypes: usize,
    visibility_degree: usize,
    radiance_degree: usize,
    data: [Vec<f32>; Field::COUNT],
    /// A value per Gaussian, or none.
    confidence: Vec<f32>,
}

impl Gaussians {
    /// `len` zeroed Gaussians with K = `prototypes`, visibility of degree `visibility_degree` and radiance of degree
    /// `radiance_degree`.
    pub fn zeroed(len: usize, prototypes: usize, visibility_degree: usize, radiance_degree: usize) -> Self {
        let (data, confidence) = Default::default();
        let mut out = Self { len, prototypes, visibility_degree, radiance_degree, data, confidence };
        for field in Field::ALL {
            out.data[field as usize] = vec![0.0; len * out.width(field)];
        }
        out
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True when there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Number K of albedo prototypes.
    pub fn prototypes(&self) -> usize {
        self.prototypes
    }

    /// Highest SH degree of the visibility field.
    pub fn visibility_degree(&self) -> usize {
        self.visibility_degree
    }

    /// Highest SH degree of the radiance branch.
    pub fn radiance_degree(&self) -> usize {
        self.radiance_degree
    }

    /// Floats per Gaussian in `field`.
    pub fn width(&self, field: Field) -> usize {
        match field.width() {
            FieldWidth::Fixed(floats) => floats,
            FieldWidth::Prototypes => self.prototypes,
            FieldWidth::Visibility => sh_count(self.visibility_degree),
            FieldWidth::Radiance => 3 * sh_count(self.radiance_degree),
        }
    }

    /// The whole array of `field`, `len * width` floats.
    pub fn field(&self, field: Field) -> &[f32] {
        &self.data[field as usize]
    }

    /// The whole array of `field`, mutable.
    pub fn field_mut(&mut self, field: Field) -> &mut [f32] {
        &mut self.data[field as usize]
    }

    /// All arrays at once, in [`Field::ALL`] order, each with its width.
    pub fn fields_mut(&mut self) -> impl Iterator<Item = (Field, usize, &mut Vec<f32>)> {
        let widths = Field::ALL.map(|f| self.width(f));
        Field::ALL.into_iter().zip(widths).zip(self.data.iter_mut()).map(|((f, w), d)| (f, w, d))
    }

    /// The floats of Gaussian `i` in `field`.
    pub fn row(&self, field: Field, i: usize) -> &[f32] {
        let w = self.width(field);
        &self.data[field as usize][i * w..(i + 1) * w]
    }

    /// The floats of Gaussian `i` in `field`, mutable.
    pub fn row_mut(&mut self, field: Field, i: usize) -> &mut [f32] {
        let w = self.width(field);
        &mut self.data[field as usize][i * w..(i + 1) * w]
    }

    /// The floats of Gaussian `i` as an array; `W` must be the field's width.
    pub fn get<const W: usize>(&self, field: Field, i: usize) -> [f32; W] {
        let mut out = [0.0; W];
        out.copy_from_slice(self.row(field, i));
        out
    }

    /// Confidence of each Gaussian, 0 to 1 (docs/MODEL.md, section 10); `None` where it was not measured. A measurement, not a parameter: no
    /// kernel reads it.
    pub fn confidence(&self) -> Option<&[f32]> {
        (!self.confidence.is_empty()).then_some(&self.confidence)
    }

    /// Stores the confidence of each Gaussian. An array of another length means that it was not measured.
    pub fn set_confidence(&mut self, confidence: Vec<f32>) {
        self.confidence = if confidence.len() == self.len { confidence } else { Vec::new() };
    }

    /// False for a Gaussian that no photograph shows: frames omit it ([`Field::SamplingRate`]).
    #[inline]
    pub fn is_photographed(&self, i: usize) -> bool {
        !(self.row(Field::SamplingRate, i)[0] < 0.0)
    }

    /// A copy of the Gaussians that frames show.
    #[must_use]
    pub fn photographed(&self) -> Self {
        let shown: Vec<usize> = (0..self.len).filter(|i| self.is_photographed(*i)).collect();
        self.gathered(&shown)
    }

    /// A copy of the Gaussians at `indices`, in that order; an index may repeat.
    #[must_use]
    pub fn gathered(&self, indices: &[usize]) -> Self {
        let confidence = indices.iter().filter_map(|i| self.confidence.get(*i).copied()).collect();
        let mut out = Self { len: indices.len(), data: Default::default(), confidence, ..*self };
        for field in Field::ALL {
            let rows = indices.iter().flat_map(|&i| self.row(field, i).iter().copied());
            out.data[field as usize] = rows.collect();
        }
        out
    }

    /// The same Gaussians with other radiance coefficients, of degree `sh_degree`: `3 (sh_degree + 1)^2` per Gaussian. Zeros
    /// fill up where `coefficients` has fewer.
    #[must_use]
    pub fn with_radiance(mut self, sh_degree: usize, mut coefficients: Vec<f32>) -> Self {
        self.radiance_degree = sh_degree;
        coefficients.resize(self.len * self.width(Field::Radiance), 0.0);
        self.data[Field::Radiance as usize] = coefficients;
        self
    }

    /// True when every float is finite.
    pub fn is_finite(&self) -> bool {
        self.data.iter().flatten().chain(&self.confidence).all(|v| v.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gathering_repeats_and_reorders_rows() {
        let mut g = Gaussians::zeroed(3, 2, 1, 0);
        for i in 0..3 {
            g.row_mut(Field::Mean, i).fill(i as f32);
        }
        let picked = g.gathered(&[2, 0, 2]);
        assert_eq!(picked.field(Field::Mean), &[2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0]);
        assert_eq!(picked.field(Field::ProtoLogits).len(), 6);
    }

    #[test]
    fn confidence_follows_its_gaussians() {
        let mut g = Gaussians::zeroed(3, 1, 0, 0);
        assert_eq!(g.gathered(&[1]).confidence(), None);
        g.set_confidence(vec![0.1, 0.2, 0.3]);
        assert_eq!(g.gathered(&[2, 0, 2]).confidence(), Some(&[0.3, 0.1, 0.3][..]));
        g.set_confidence(vec![0.1]);
        assert_eq!(g.confidence(), None, "of another model");
    }

    #[test]
    fn is_finite_detects_a_single_nan() {
        let mut g = Gaussians::zeroed(2, 2, 4, 1);
        assert!(g.is_finite());
        g.field_mut(Field::Visibility)[30] = f32::NAN;
        assert!(!g.is_finite());
    }
}
