// A camera as the kernels want it. Kept in step with `ViewUniform` of src/engine/gpu/view.rs.
#import generated/projection

struct View {
    focal: vec2f,
    centre_px: vec2f,
    // Rows of the world-to-camera matrix: rotation in xyz, translation in w.
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

// Camera coordinates of a world point: `R x + t`. Models lie around the origin, so this keeps the digits across the view
// of a camera that is far away, where `R (x - centre)` would lose those of `x`.
fn to_camera(view: View, x: vec3f) -> vec3f {
    let turned = vec3f(dot(view.rotation[0].xyz, x), dot(view.rotation[1].xyz, x), dot(view.rotation[2].xyz, x));
    return turned + vec3f(view.rotation[0].w, view.rotation[1].w, view.rotation[2].w);
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
