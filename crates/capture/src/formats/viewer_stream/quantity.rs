//! A quantity of a stream: a name, rows of values, and their encoding.

use half::f16;
use serde_json::{Value, json};

/// Encoding of a value, little-endian.
#[derive(Debug, Clone, PartialEq)]
enum ValueEncoding {
    /// Unchanged.
    F32,
    /// Divided by a scale.
    F16 { scale: f32 },
    /// Fraction of the range from the least to the greatest value of the column, in 65,536 steps.
    U16 { low: Vec<f32>, high: Vec<f32> },
    /// As `U16`, in 256 steps.
    U8 { low: Vec<f32>, high: Vec<f32> },
}

/// A quantity with `components` values per row.
#[derive(Debug, Clone)]
pub(super) struct Quantity {
    name: &'static str,
    components: usize,
    encoding: ValueEncoding,
    values: Vec<f32>,
}

impl Quantity {
    /// Values as f32.
    pub(super) fn full(name: &'static str, components: usize, values: Vec<f32>) -> Self {
        Self { name, components, encoding: ValueEncoding::F32, values }
    }

    /// Values as half floats, scaled so that the largest is in range.
    pub(super) fn half(name: &'static str, components: usize, values: Vec<f32>) -> Self {
        let most = values.iter().fold(0.0f32, |most, v| most.max(v.abs()));
        let scale = if most > 0.0 { (most / 32768.0).max(f32::MIN_POSITIVE) } else { 1.0 };
        Self { name, components, encoding: ValueEncoding::F16 { scale }, values }
    }

    /// Values in 65,536 steps between the bounds of each column.
    pub(super) fn fine(name: &'static str, components: usize, values: Vec<f32>) -> Self {
        let (low, high) = bounds(components, &values);
        Self { name, components, encoding: ValueEncoding::U16 { low, high }, values }
    }

    /// Values in 65,536 steps between bounds that all columns share.
    pub(super) fn fine_within(
        name: &'static str,
        components: usize,
        [low, high]: [f32; 2],
        values: Vec<f32>,
    ) -> Self {
        let encoding = ValueEncoding::U16 { low: vec![low; components], high: vec![high; components] };
        Self { name, components, encoding, values }
    }

    /// Values in 256 steps between the bounds of each column.
    pub(super) fn coarse(name: &'static str, components: usize, values: Vec<f32>) -> Self {
        let (low, high) = bounds(components, &values);
        Self { name, components, encoding: ValueEncoding::U8 { low, high }, values }
    }

    pub(super) fn rows(&self) -> usize {
        self.values.len() / self.components.max(1)
    }

    pub(super) fn row_bytes(&self) -> usize {
        self.components
            * match self.encoding {
                ValueEncoding::F32 => 4,
                ValueEncoding::F16 { .. } | ValueEncoding::U16 { .. } => 2,
                ValueEncoding::U8 { .. } => 1,
            }
    }

    /// Description for a reader. `count` is the number of rows.
    pub(super) fn to_json(&self) -> Value {
        let how = match &self.encoding {
            ValueEncoding::F32 => json!({ "type": "f32" }),
            ValueEncoding::F16 { scale } => json!({ "type": "f16", "scale": scale }),
            ValueEncoding::U16 { low, high } => json!({ "type": "u16", "low": low, "high": high }),
            ValueEncoding::U8 { low, high } => json!({ "type": "u8", "low": low, "high": high }),
        };
        let mut out = json!({ "name": self.name, "components": self.components, "count": self.rows() });
        if let (Value::Object(out), Value::Object(how)) = (&mut out, how) {
            out.extend(how);
        }
        out
    }

    pub(super) fn write_row(&self, row: usize, out: &mut Vec<u8>) {
        let values = &self.values[row * self.components..(row + 1) * self.components];
        for (k, &value) in values.iter().enumerate() {
            match &self.encoding {
                ValueEncoding::F32 => out.extend(value.to_le_bytes()),
                ValueEncoding::F16 { scale } => out.extend(f16::from_f32(value / scale).to_le_bytes()),
                ValueEncoding::U16 { low, high } => {
                    out.extend((share(value, low[k], high[k], 65535.0) as u16).to_le_bytes());
                }
                ValueEncoding::U8 { low, high } => out.push(share(value, low[k], high[k], 255.0) as u8),
            }
        }
    }
}

/// Position of `value` between `low` and `high`, in `steps` steps, rounded.
fn share(value: f32, low: f32, high: f32, steps: f32) -> f32 {
    let span = high - low;
    if span > 0.0 { ((value - low) / span).clamp(0.0, 1.0).mul_add(steps, 0.5).floor() } else { 0.0 }
}

/// Least and greatest value of each column.
fn bounds(components: usize, values: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let column = |k: usize| values.iter().skip(k).step_by(components.max(1)).copied();
    let of =
        |pick: fn(f32, f32) -> f32| (0..components).map(|k| column(k).reduce(pick).unwrap_or(0.0)).collect();
    (of(f32::min), of(f32::max))
}
