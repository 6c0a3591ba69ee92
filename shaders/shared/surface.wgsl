// What a pixel or a Gaussian is shaded from (`Surface` of src/engine/cpu/shade.rs). The permutation defines S, the number
// of visibility coefficients.

// Groups of four visibility coefficients.
const N_QUADS = (S + 3u) / 4u;
// First group of visibility coefficients in a row of channels (src/engine/channel.rs).
const VISIBILITY_GROUP = 5u;

struct Surface {
    // Any length.
    normal: vec3f,
    metal: f32,
    albedo: vec3f,
    rough: f32,
    // Sheen of a Gaussian, none in the pixel (src/light/sheen.rs).
    sheen: f32,
    // Irradiance gathered from other surfaces, and radiance where the environment is blocked.
    gathered: vec3f,
    indirect: vec3f,
    // Unit direction to the camera.
    view: vec3f,
    // Zero-padded.
    visibility: array<vec4f, N_QUADS>,
}

// Group `quad` of the visibility coefficients with what lies beyond S zeroed, whatever the buffer holds there.
fn masked_quad(quad: u32, value: vec4f) -> vec4f {
    return select(vec4f(0.0), value, quad * 4u + vec4u(0u, 1u, 2u, 3u) < vec4u(S));
}

// From groups 1 to 4 of a row of channels, scaled; visibility is left to the caller.
fn surface_of_groups(g1: vec4f, g2: vec4f, g3: vec4f, g4: vec4f, scale: f32, towards: vec3f) -> Surface {
    var s: Surface;
    s.normal = g1.xyz * scale;
    s.albedo = g2.xyz * scale;
    s.metal = g2.w * scale;
    s.rough = g3.x * scale;
    s.sheen = 0.0;
    s.gathered = g3.yzw * scale;
    s.indirect = g4.yzw * scale;
    s.view = towards;
    return s;
}
