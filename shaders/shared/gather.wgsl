// Sizes of a gathering of bounced light. Kept in step with `GatherSize` of src/engine/gpu/gather.rs.
#import finite

const WG_SIZE = 256u;
const FRAC_1_PI = 0.31830989;

struct GatherSize {
    // Gaussians.
    n: u32,
    n_directions: u32,
    // 4 pi / D.
    weight: f32,
    // Nodes along an edge of the diffuse table, and floats a colour has in it.
    diffuse_n: u32,
    coefficients: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}
