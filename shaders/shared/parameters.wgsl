// Where each parameter of a model lies in the planar buffer: element k of field F of Gaussian i is at
// `layout.F + i * width of F + k`. Kept in step with `LayoutUniform` of src/engine/gpu/model.rs.
struct Layout {
    n: u32,
    n_scores: u32,
    // Visibility and radiance: SH coefficients, not floats.
    n_visibility: u32,
    n_radiance: u32,
    mean: u32,
    log_scale: u32,
    quaternion: u32,
    opacity: u32,
    normal: u32,
    metal: u32,
    rough: u32,
    sheen: u32,
    scores: u32,
    residual: u32,
    visibility: u32,
    indirect: u32,
    radiance: u32,
    normal_form: u32,
    indirect_form: u32,
    visibility_form: u32,
    diffuse_form: u32,
    shade_at: u32,
    pad_0: u32,
    pad_1: u32,
}

const NORMAL_FREE = 0u;
const NORMAL_SHORTEST_AXIS = 1u;
const INDIRECT_OFF = 0u;
const INDIRECT_LEARNED = 1u;
const INDIRECT_GATHERED = 2u;
const VISIBILITY_OFF = 0u;
const VISIBILITY_LINEAR = 1u;
const VISIBILITY_SIGMOID = 2u;
const DIFFUSE_AMBIENT_OCCLUSION = 0u;
const DIFFUSE_DIRECTIONAL = 1u;
const SHADE_AT_PIXEL = 0u;
const SHADE_AT_GAUSSIAN = 1u;
