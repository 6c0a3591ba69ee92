//! Gradients of a model's parameters, one row a Gaussian.

use rayon::prelude::*;

use crate::zeros;
use relume_layout::channel::{self, OutgoingRadiance};
use relume_scene::{Field, Gaussians};

/// Where each field starts in a gradient row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowLayout {
    offset: [usize; Field::COUNT],
    width: [usize; Field::COUNT],
    /// Floats in a row.
    pub row: usize,
}

impl RowLayout {
    /// The layout for Gaussians shaped like `g`.
    pub fn new(g: &Gaussians) -> Self {
        Self::of(g, |_| true)
    }

    /// The layout where only the first `count` channels of the G-buffer are differentiated: fields that none of them
    /// depends on have no floats in a row.
    pub fn differentiated(g: &Gaussians, count: usize) -> Self {
        Self::of(g, |field| match field {
            Field::Visibility | Field::Indirect => count >= channel::VISIBILITY,
            Field::MetalLogit | Field::RoughLogit | Field::ProtoLogits | Field::Residual => {
                count > channel::ROUGH
            }
            Field::Sheen => count > OutgoingRadiance::SHEEN_GRADIENT,
            Field::Normal => count > channel::PLANE,
            _ => true,
        })
    }

    fn of(g: &Gaussians, has: impl Fn(Field) -> bool) -> Self {
        let width = Field::ALL.map(|f| if has(f) { g.width(f) } else { 0 });
        let mut offset = [0; Field::COUNT];
        let mut row = 0;
        for field in Field::ALL {
            offset[field as usize] = row;
            row += width[field as usize];
        }
        Self { offset, width, row }
    }

    /// Range of `field` in a row.
    #[inline]
    pub fn range(&self, field: Field) -> std::ops::Range<usize> {
        let start = self.offset[field as usize];
        start..start + self.width[field as usize]
    }
}

/// Gradient of a scalar by every parameter of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradients {
    /// Layout of the rows.
    pub layout: RowLayout,
    /// One row a Gaussian, `layout.row` floats.
    pub rows: Vec<f32>,
    /// By prototype, RGB.
    pub prototypes: Vec<[f32; 3]>,
    /// By raw environment texel.
    pub env_raw: Vec<[f32; 3]>,
    /// Sum over pixels of the length of each one's gradient by the projected mean, in half image widths, per Gaussian
    /// (AbsGS's density signal).
    pub absgrad: Vec<f32>,
    /// Gaussians that were on screen.
    pub visible: Vec<bool>,
}

impl Gradients {
    /// All zero, for a model with these Gaussians and this many environment texels.
    pub fn zeroed(g: &Gaussians, texels: usize) -> Self {
        Self::laid_out(g, RowLayout::new(g), texels)
    }

    /// All zero, with rows of this layout.
    pub fn laid_out(g: &Gaussians, layout: RowLayout, texels: usize) -> Self {
        Self {
            layout,
            rows: zeros(g.len() * layout.row),
            prototypes: vec![[0.0; 3]; g.prototypes()],
            env_raw: vec![[0.0; 3]; texels],
            absgrad: vec![0.0; g.len()],
            visible: vec![false; g.len()],
        }
    }

    /// The floats of Gaussian `i` in `field`; none where it was not differentiated.
    pub fn get(&self, field: Field, i: usize) -> &[f32] {
        let range = self.layout.range(field);
        &self.rows[i * self.layout.row..][range]
    }

    /// The floats of Gaussian `i` in `field`, to be added to.
    pub fn get_mut(&mut self, field: Field, i: usize) -> &mut [f32] {
        let range = self.layout.range(field);
        &mut self.rows[i * self.layout.row..][range]
    }

    /// True when every value is finite.
    pub fn is_finite(&self) -> bool {
        let are_finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
        let globals = [&self.prototypes, &self.env_raw];
        self.rows.par_chunks(1 << 16).all(are_finite) && globals.iter().all(|g| are_finite(g.as_flattened()))
    }
}
