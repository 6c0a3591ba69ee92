//! Binary glTF 2.0.

mod container;
mod mesh;
mod splats;

pub use container::GltfTooLarge;
pub use mesh::{TexturedMesh, encode_mesh};
pub use splats::encode_splats;
