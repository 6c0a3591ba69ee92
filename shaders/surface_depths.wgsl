// Camera depth of the surface that each pixel sees, on the plane of the Gaussian at which coverage reaches half of the pixel's
// (crates/engine/src/cpu/point.rs). A thread owns a pixel. No workgroup memory: the threads of a tile read the same splats.
#import alpha
#import camera
#import generated/channels
#import generated/surface_point

struct Rows {
    // Groups per attribute row.
    groups: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> rows: Rows;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> attributes: array<vec4f>;
@group(0) @binding(4) var<storage, read> gaussian_of_slot: array<u32>;
@group(0) @binding(5) var<storage, read> first_slot: array<u32>;
@group(0) @binding(6) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> depths: array<f32>;

// Depth at which `ray` meets the plane of a Gaussian, or its centre's depth where the plane is seen edge-on.
fn depth_on_plane(gaussian_ix: u32, centre: f32, ray: vec3f) -> f32 {
    let row = attributes[gaussian_ix * rows.groups + NORMAL_GROUP];
    let along = dot(channel_normal(row), ray);
    let depth = channel_plane(row) / select(along, 1e-30, along == 0.0);
    return select(centre, depth, abs(depth - centre) <= MAX_PLANE_DEPTH_ERROR * centre);
}

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(workgroup_id) wid: vec3u) {
    if gid.x >= camera.size.x || gid.y >= camera.size.y {
        return;
    }
    let pixel_ix = gid.y * camera.size.x + gid.x;
    let tile_ix = wid.y * camera.tiles.x + wid.x;
    let end = first_slot[tile_ix + 1u];
    let half = 1.0 - 0.5 * channel_coverage(gbuffer[pixel_ix]);
    let ray = pixel_ray(camera, gid.x, gid.y);
    let centre = vec2f(gid.xy) + 0.5;
    var left = 1.0;
    var depth = 0.0;
    for (var slot_ix = first_slot[tile_ix]; slot_ix < end && left > half; slot_ix++) {
        let gaussian_ix = gaussian_of_slot[slot_ix];
        let alpha = capped(alpha_at(footprint_of(splats[gaussian_ix]), centre));
        if alpha > 0.0 {
            left *= 1.0 - alpha;
            depth = depth_on_plane(gaussian_ix, splats[gaussian_ix].depth, ray);
        }
    }
    depths[pixel_ix] = depth;
}
