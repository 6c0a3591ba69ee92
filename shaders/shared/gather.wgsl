// Sizes of a gathering of bounced light. Kept in step with `GatherSize` of src/engine/gpu/gather.rs.
const WG_SIZE = 256u;

struct GatherSize {
    // Gaussians.
    n: u32,
    n_directions: u32,
    // 4 pi / D.
    weight: f32,
    pad: u32,
}
