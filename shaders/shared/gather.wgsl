// Sizes of the gathering of light. Kept in step with `GatherSize` of crates/engine/src/gpu/gather/mod.rs.
const WG_SIZE = 256u;

struct GatherSize {
    // Number of Gaussians.
    n: u32,
    n_directions: u32,
    // 4 pi / D.
    weight: f32,
    pad: u32,
}
