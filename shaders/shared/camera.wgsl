// A camera. Kept in step with `CameraUniform` of crates/engine/src/gpu/camera.rs.
#import generated/projection

struct Camera {
    focal: vec2f,
    centre_px: vec2f,
    // Rows of the world-to-camera matrix: rotation in xyz, translation in w.
    rotation: array<vec4f, 3>,
    centre: vec4f,
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

// Low-pass of a Gaussian at `depth`, px^2: 0.7 of that of the photograph that shows it largest, with `sampling_rate` pixels per unit of
// length, where this camera shows it larger. A rate of 0 is unknown.
fn low_pass_of(camera: Camera, depth: f32, sampling_rate: f32) -> f32 {
    if !(sampling_rate > 0.0) {
        return camera.low_pass;
    }
    let enlargement = min(sqrt(camera.focal.x * camera.focal.y) / (depth * sampling_rate), MAX_ENLARGEMENT);
    return camera.low_pass * max(ENLARGED_LOW_PASS * enlargement * enlargement, 1.0);
}

// Camera coordinates of a world point: `R x + t`. Models lie around the origin, so for a far-away camera this form keeps the
// digits of `x` that `R (x - centre)` would lose.
fn to_camera(camera: Camera, x: vec3f) -> vec3f {
    let turned = vec3f(dot(camera.rotation[0].xyz, x), dot(camera.rotation[1].xyz, x), dot(camera.rotation[2].xyz, x));
    return turned + vec3f(camera.rotation[0].w, camera.rotation[1].w, camera.rotation[2].w);
}

// World direction of a camera-space direction: `R^T d`.
fn to_world(camera: Camera, d: vec3f) -> vec3f {
    return d.x * camera.rotation[0].xyz + d.y * camera.rotation[1].xyz + d.z * camera.rotation[2].xyz;
}

// World direction through the centre of pixel (x, y), z_c = 1, not normalised.
fn pixel_ray(camera: Camera, x: u32, y: u32) -> vec3f {
    let uv = (vec2f(f32(x), f32(y)) + 0.5 - camera.centre_px) / camera.focal;
    return to_world(camera, vec3f(uv, 1.0));
}
