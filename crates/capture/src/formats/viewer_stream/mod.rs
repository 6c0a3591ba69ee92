//! The data with which a viewer draws a model, usable before the download is complete (docs/viewer-stream.md): a JSON
//! header, arrays, then one record per Gaussian in the order of decreasing importance.

mod gaussians;
mod light;
mod quantity;

pub use gaussians::{encode_gaussians, importance_order};
pub use light::{StreamedLight, StreamedSurface, encode_light};

use serde_json::{Map, Value, json};

use quantity::Quantity;

/// Version of both streams. A viewer refuses unknown versions.
pub const VERSION: u32 = 1;

/// Header, arrays and records. All quantities of `records` have the same number of rows.
fn encode(
    magic: [u8; 4],
    mut facts: Map<String, Value>,
    arrays: &[Quantity],
    records: &[Quantity],
) -> Vec<u8> {
    let count = records.first().map_or(0, Quantity::rows);
    let stride: usize = records.iter().map(Quantity::row_bytes).sum();
    facts.insert("arrays".to_owned(), arrays.iter().map(Quantity::to_json).collect());
    let fields: Value = records.iter().map(Quantity::to_json).collect();
    facts.insert("records".to_owned(), json!({ "count": count, "stride": stride, "fields": fields }));
    let mut header = Value::Object(facts).to_string().into_bytes();
    header.resize(header.len().next_multiple_of(4), b' ');

    let mut out = Vec::with_capacity(12 + header.len() + count * stride);
    out.extend(magic);
    out.extend(VERSION.to_le_bytes());
    out.extend((header.len() as u32).to_le_bytes());
    out.extend(header);
    for array in arrays {
        (0..array.rows()).for_each(|row| array.write_row(row, &mut out));
        out.resize(out.len().next_multiple_of(4), 0);
    }
    for row in 0..count {
        records.iter().for_each(|quantity| quantity.write_row(row, &mut out));
    }
    out
}

#[cfg(test)]
mod tests;
