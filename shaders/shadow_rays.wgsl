// Adds each pixel's reflection of one small light, weighted by its arriving share: the mean over rays from
// points within the pixel to points of the light (the port of `PixelShadows` of
// crates/engine/src/cpu/pixel_light.rs). A thread owns a pixel. No workgroup memory.
#import camera
#import generated/channels
#import generated/light
#import generated/surface_point
#import quaternion
#import ray_tree
#import sharp_light

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> light: SharpLight;
@group(0) @binding(2) var<uniform> rules: RayRules;
@group(0) @binding(3) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(4) var<storage, read> depths: array<f32>;
// Blended reflection: coverage and the sum, 0 and the specular part.
@group(0) @binding(5) var<storage, read> reflected: array<vec4f>;
@group(0) @binding(6) var<storage, read> nodes: array<vec4u>;
@group(0) @binding(7) var<storage, read> members: array<vec4f>;
// Diffuse and specular radiance of all lights, times coverage.
@group(0) @binding(8) var<storage, read_write> direct: array<vec4f>;

// The world point for an image position, slightly in front of the surface: on the pixel's mean plane where that is near the
// surface at depth `seen`, else at depth `seen`.
fn point_at(place: vec2f, seen: f32, plane: vec4f, lift: vec3f) -> vec3f {
    let uv = (place - camera.centre_px) / camera.focal;
    let ray = to_world(camera, vec3f(uv, 1.0));
    let along = dot(channel_normal(plane), ray);
    let mean = channel_plane(plane) / select(along, 1e-30, along == 0.0);
    let depth = select(seen, mean, abs(mean - seen) <= MAX_MEAN_DEPTH_ERROR * seen);
    return camera.centre.xyz + depth * ray + lift;
}

fn share_of(pixel: vec2u, pixel_ix: u32) -> f32 {
    var places = SHADOW_SAMPLE_OFFSETS;
    let plane = gbuffer[NORMAL_GROUP * camera.n_pixels + pixel_ix];
    let normal = normalised3(channel_normal(plane));
    let away = dot(normal, pixel_ray(camera, pixel.x, pixel.y)) > 0.0;
    let lift = select(LIFT, -LIFT, away) * normal;
    var sum = 0.0;
    for (var i = 0u; i < light.n_rays; i++) {
        let at = 2u * (i % N_SHADOW_SAMPLES);
        let place = vec2f(pixel) + 0.5 + vec2f(places[at], places[at + 1u]);
        let point = point_at(place, depths[pixel_ix], plane, lift);
        sum += ray_transmittance(point, light.directions[i % light.n_directions].xyz, rules);
    }
    return sum / f32(light.n_rays);
}

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) gid: vec3u) {
    if gid.x >= camera.size.x || gid.y >= camera.size.y {
        return;
    }
    let pixel_ix = gid.y * camera.size.x + gid.x;
    if !(channel_coverage(gbuffer[pixel_ix]) >= MIN_COVERAGE) {
        return;
    }
    let total = reflected[pixel_ix].yzw;
    let specular = reflected[camera.n_pixels + pixel_ix].yzw;
    if !any(total > vec3f(0.0)) {
        return;
    }
    var share = 1.0;
    if light.n_rays > 0u {
        share = share_of(gid.xy, pixel_ix);
    }
    direct[pixel_ix] += vec4f(share * (total - specular), 0.0);
    direct[camera.n_pixels + pixel_ix] += vec4f(share * specular, 0.0);
}
