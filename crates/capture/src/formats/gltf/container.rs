//! The container of binary glTF 2.0: a JSON document and its binary data.

use serde_json::{Value, json};

/// `ARRAY_BUFFER`.
const VERTICES: u32 = 34962;
/// `ELEMENT_ARRAY_BUFFER`.
const INDICES: u32 = 34963;
/// `UNSIGNED_INT`.
const UNSIGNED_INT: u32 = 5125;
/// `FLOAT`.
const FLOAT: u32 = 5126;

/// The contents exceed the 4 GiB of a `.glb` file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a .glb file can have at most 4 GiB")]
pub struct GltfTooLarge;

/// The `asset` object of a document.
pub(super) fn asset() -> Value {
    json!({ "version": "2.0", "generator": concat!("Relume ", env!("CARGO_PKG_VERSION")) })
}

/// The binary chunk of a file and the accessors into it.
#[derive(Default)]
pub(super) struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds rows of floats; returns the index of their accessor.
    pub(super) fn rows<const N: usize>(&mut self, rows: impl ExactSizeIterator<Item = [f32; N]>) -> Value {
        let (count, kind) = (rows.len(), ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1]);
        let view = self.view(rows.flatten().flat_map(f32::to_le_bytes), Some(VERTICES));
        self.accessors.push(json!({
            "bufferView": view, "componentType": FLOAT, "count": count, "type": kind,
        }));
        json!(self.accessors.len() - 1)
    }

    /// Adds vertex indices; returns the index of their accessor.
    pub(super) fn indices(&mut self, indices: &[u32]) -> Value {
        let view = self.view(indices.iter().flat_map(|i| i.to_le_bytes()), Some(INDICES));
        self.accessors.push(json!({
            "bufferView": view, "componentType": UNSIGNED_INT, "count": indices.len(), "type": "SCALAR",
        }));
        json!(self.accessors.len() - 1)
    }

    /// Adds a PNG; returns its image object.
    pub(super) fn image(&mut self, png: &[u8]) -> Value {
        json!({ "bufferView": self.view(png.iter().copied(), None), "mimeType": "image/png" })
    }

    /// Adds bytes with a buffer target; returns the index of their view.
    fn view(&mut self, bytes: impl Iterator<Item = u8>, target: Option<u32>) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    /// As [`Self::rows`], for positions, whose bounds a file must state.
    pub(super) fn positions(&mut self, rows: impl ExactSizeIterator<Item = [f32; 3]> + Clone) -> Value {
        let bound = |pick: fn(f32, f32) -> f32| {
            rows.clone().reduce(|a, b| std::array::from_fn(|k| pick(a[k], b[k]))).unwrap_or_default()
        };
        let (least, most) = (bound(f32::min), bound(f32::max));
        let index = self.rows(rows);
        if let Some(accessor) = self.accessors.last_mut() {
            (accessor["min"], accessor["max"]) = (json!(least), json!(most));
        }
        index
    }

    /// The bytes of a file with `document`, to which the buffers are added, and the binary chunk.
    pub(super) fn finish(self, mut document: Value) -> Result<Vec<u8>, GltfTooLarge> {
        document["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        (document["bufferViews"], document["accessors"]) = (json!(self.views), json!(self.accessors));
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let whole = 28 + text.len() + self.bytes.len();
        let mut out = Vec::with_capacity(whole);
        out.extend(b"glTF");
        let whole = u32::try_from(whole).map_err(|_| GltfTooLarge)?;
        [2, whole].iter().for_each(|word| out.extend(word.to_le_bytes()));
        for (name, chunk) in [(b"JSON", &text), (b"BIN\0", &self.bytes)] {
            out.extend((chunk.len() as u32).to_le_bytes());
            out.extend(name);
            out.extend(chunk);
        }
        Ok(out)
    }
}
