//! Gradients of a model's parameters, one row per Gaussian.

use rayon::prelude::*;

use crate::zeros;
use relume_layout::channel::{self, OutgoingRadiance};
use relume_scene::{Field, Gaussians};

/// Layout of a gradient row: the range of each field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowLayout {
    offset: [usize; Field::COUNT],
    width: [usize; Field::COUNT],
    /// Floats in a row.
    pub row: usize,
}

impl RowLayout {
    /// The layout for Gaussians with the widths of `g`.
    pub fn new(g: &Gaussians) -> Self {
        Self::of(g, |_| true)
    }

    /// The layout where only the first `count` channels of the G-buffer are differentiated. Fields that these channels do not
    /// depend on have no floats in a row.
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
    /// One row of `layout.row` floats per Gaussian.
    pub rows: Vec<f32>,
    /// Gradient by prototype, RGB.
    pub prototypes: Vec<[f32; 3]>,
    /// Gradient by raw environment texel.
    pub env_raw: Vec<[f32; 3]>,
    /// Per Gaussian, the sum over pixels of the length of each pixel's gradient by the projected mean, in half image widths
    /// (AbsGS's density signal).
    pub absgrad: Vec<f32>,
    /// True for Gaussians that were on screen.
    pub visible: Vec<bool>,
}

impl Gradients {
    /// All zero, for a model with these Gaussians and this many environment texels.
    pub fn zeroed(g: &Gaussians, texels: usize) -> Self {
        Self::laid_out(g, RowLayout::new(g), texels)
    }

    /// All zero, with rows of layout `layout`.
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

    /// The floats of Gaussian `i` in `field`; empty where the field was not differentiated.
    pub fn get(&self, field: Field, i: usize) -> &[f32] {
        let range = self.layout.range(field);
        &self.rows[i * self.layout.row..][range]
    }

    /// The floats of Gaussian `i` in `field`, mutable.
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
