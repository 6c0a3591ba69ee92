// A dominant light of an environment (crates/scene/src/light/dominant.rs), and its reflection by a surface.
#import reflector
#import sheen

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
    pad: u32,
    // Unit vectors towards points of the light; w is unused.
    directions: array<vec4f, 7>,
}

fn sent_of(r: Reflector, light: SharpLight, sheen: f32) -> Reflected {
    let reflected = reflect_light(r, light.direction.xyz, light.direction.w);
    let gain = sheen_of(sheen, min(abs(dot(r.normal, r.view)), 1.0)).gain;
    return Reflected(light.irradiance.xyz * reflected.diffuse * gain, light.irradiance.xyz * reflected.specular);
}
