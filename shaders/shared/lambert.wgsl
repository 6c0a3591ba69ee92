// The diffuse term of a surface, in a pixel or at a Gaussian: the port of crates/engine/src/cpu/lambert.rs, a part of
// `shading`.

// A diffuse term with the values that its backward pass needs.
struct Lambert {
    radiance: vec3f,
    irradiance: vec3f,
    // Irradiance, including gathered light and dominant lights.
    incoming: vec3f,
    // Irradiance before the clamp; the next member has it per tap.
    irradiance_raw: vec3f,
    tap_irradiance: array<vec3f, 4>,
    taps: Taps,
    ambient: f32,
    ambient_raw: f32,
}

// The diffuse term for the unit `normal` of a surface, turned to the camera, and the irradiance of the dominant lights.
fn lambert(s: ptr<function, Surface>, normal: vec3f, of_lights: vec3f) -> Lambert {
    var f: Lambert;
    // Four tabulated normals around n.
    f.taps = cube_taps(tables.diffuse_n, normal);
    f.irradiance_raw = vec3f(0.0);
#repeat k 4
    f.tap_irradiance[$k] = node_irradiance(s, f.taps.node[$k]);
    f.irradiance_raw += f.taps.weight[$k] * f.tap_irradiance[$k];
#end
    f.ambient = 1.0;
    f.ambient_raw = 1.0;
    if is_scalar() && !is_open() {
        f.ambient_raw = ambient_raw(s, normal);
        f.ambient = squash(f.ambient_raw);
    }
    f.irradiance = max(f.irradiance_raw, vec3f(0.0)) * f.ambient;
    f.incoming = f.irradiance + (*s).gathered + of_lights;
    f.radiance = (*s).albedo * ((1.0 - (*s).metal) * INV_PI) * f.incoming;
    return f;
}
