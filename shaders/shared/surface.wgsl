// A surface to shade (`Surface` of crates/engine/src/cpu/surface.rs). The permutation defines S, the number of visibility
// coefficients.

#import generated/channels

// Groups of four visibility coefficients.
const N_QUADS = (S + 3u) / 4u;

struct Surface {
    // Normal of any length.
    normal: vec3f,
    metal: f32,
    albedo: vec3f,
    rough: f32,
    // ln of the diffuse term's gain at grazing view (crates/scene/src/light/sheen.rs).
    sheen: f32,
    // Irradiance gathered from other surfaces; the next member is the radiance from blocked directions.
    gathered: vec3f,
    blocked: vec3f,
    // Arriving share of each dominant light; 0 where dominant lights are not shaded.
    arriving: vec4f,
    // Unit direction to the camera.
    view: vec3f,
    // Visibility coefficients, zero-padded.
    visibility: array<vec4f, N_QUADS>,
}

// Group `quad` of the visibility coefficients, with zeros beyond S.
fn masked_quad(quad: u32, value: vec4f) -> vec4f {
    return select(vec4f(0.0), value, quad * 4u + vec4u(0u, 1u, 2u, 3u) < vec4u(S));
}

// A surface from channels times `scale`, seen from the unit direction `towards`; without sheen. The caller sets visibility.
fn surface_of_channels(
    normal_group: vec4f,
    albedo_group: vec4f,
    rough: f32,
    gathered: vec3f,
    blocked: vec3f,
    scale: f32,
    towards: vec3f,
) -> Surface {
    var s: Surface;
    s.normal = channel_normal(normal_group) * scale;
    s.albedo = channel_albedo(albedo_group) * scale;
    s.metal = channel_metal(albedo_group) * scale;
    s.rough = rough * scale;
    s.sheen = 0.0;
    s.gathered = gathered * scale;
    s.blocked = blocked * scale;
    s.arriving = vec4f(0.0);
    s.view = towards;
    return s;
}
