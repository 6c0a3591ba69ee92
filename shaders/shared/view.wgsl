// A camera as the kernels want it. Kept in step with `ViewUniform` of src/engine/gpu/view.rs.
struct View {
    focal: vec2f,
    centre_px: vec2f,
    // Rows of the world-to-camera rotation; w is unused.
    rotation: array<vec4f, 3>,
    eye: vec4f,
    // Limits of x/z (x, y) and of y/z (z, w) inside the projection's Jacobian.
    ratio_limits: vec4f,
    // Width and height, pixels.
    size: vec2u,
    // Tile columns and rows.
    tiles: vec2u,
    low_pass: f32,
    low_pass_compensation: u32,
    n_pixels: u32,
    pad: u32,
}

const TILE = 16u;

// Camera coordinates of a world point: `R (x - eye)`, which keeps precision far from the origin.
fn to_camera(view: View, x: vec3f) -> vec3f {
    let d = x - view.eye.xyz;
    return vec3f(dot(view.rotation[0].xyz, d), dot(view.rotation[1].xyz, d), dot(view.rotation[2].xyz, d));
}

// World direction of a camera-space direction: `R^T d`.
fn to_world(view: View, d: vec3f) -> vec3f {
    return d.x * view.rotation[0].xyz + d.y * view.rotation[1].xyz + d.z * view.rotation[2].xyz;
}

// World direction through the centre of pixel (x, y), z_c = 1, not normalised.
fn pixel_ray(view: View, x: u32, y: u32) -> vec3f {
    let uv = (vec2f(f32(x), f32(y)) + 0.5 - view.centre_px) / view.focal;
    return to_world(view, vec3f(uv, 1.0));
}
