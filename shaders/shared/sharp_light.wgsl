// A dominant light of an environment (crates/scene/src/light/dominant.rs).

// Kept in step with `SharpLightUniform` of crates/engine/src/gpu/rays/shadows.rs.
struct SharpLight {
    // Unit vector; w: angular radius, radians.
    direction: vec4f,
    // Radiance times solid angle; w is unused.
    irradiance: vec4f,
    // Groups per attribute row.
    row_groups: u32,
    // Rays per pixel; 0 without occlusion.
    n_rays: u32,
    // Number of directions, which the rays use in turn.
    n_directions: u32,
    // 1: the diffuse term has the share of the light that the highlight leaves.
    conserves_energy: u32,
    // Unit vectors towards points of the light; w is unused.
    directions: array<vec4f, 7>,
}
