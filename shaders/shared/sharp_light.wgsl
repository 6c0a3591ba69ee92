// A strong small light of an environment, taken by itself (src/light/dominant.rs), and what a surface sends of it.
#import reflector
#import sheen

// Kept in step with `SharpLightUniform` of src/engine/gpu/rays/shadows.rs.
struct SharpLight {
    // Unit vector; w: angular radius, radians.
    direction: vec4f,
    // Radiance times solid angle; w is unused.
    irradiance: vec4f,
    // Groups of a row of attributes.
    row_groups: u32,
    // Rays of a pixel; 0 where nothing hides anything.
    n_rays: u32,
    // Directions that these take in turn.
    n_directions: u32,
    pad: u32,
    // Unit vectors towards places of the light; w is unused.
    directions: array<vec4f, 7>,
}

fn sent_of(r: Reflector, light: SharpLight, sheen: f32) -> Reflected {
    let reflected = reflect_light(r, light.direction.xyz, light.direction.w);
    let gain = sheen_of(sheen, min(abs(dot(r.normal, r.view)), 1.0)).gain;
    return Reflected(light.irradiance.xyz * reflected.diffuse * gain, light.irradiance.xyz * reflected.specular);
}
