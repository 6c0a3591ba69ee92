// Terms on the buffers (docs/MODEL.md, section 5): coverage against the mask, depth-normal consistency and edge-aware
// smoothness, values and gradients (crates/engine/src/cpu/objective/geometry.rs). A thread owns a pixel and evaluates the
// terms of its neighbours that depend on it again, so that a workgroup adds only three sums to memory. Workgroup memory holds
// those sums.
//
// Gradient by the buffers, two vec4 per pixel, planar: (normal xyz, plane distance), then (coverage, metalness, roughness).
// GEOMETRY: the pass has normals and plane distances. MATERIAL: also metalness and roughness.
const WG_SIZE = 256u;
#import photo
#import camera
#import quaternion
#import generated/channels
#import generated/light
#import generated/objective
#import generated/slots
#import reduce

// Kept in step with `SurfaceTermsUniform` of crates/engine/src/gpu/objective/mod.rs. Weights are divided by the number
// of terms of their mean.
struct SurfaceTerms {
    coverage: f32,
    depth_normal: f32,
    // 1 / number of horizontal neighbour pairs; the next member is the same for vertical pairs.
    across: f32,
    down: f32,
    // Weights of smoothness: metalness, roughness, each channel of the normal.
    smoothness: vec3f,
    // Colour of the highest level of the photograph.
    photo_white: f32,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> weights: SurfaceTerms;
@group(0) @binding(2) var<storage, read> gbuffer: array<vec4f>;
// Photograph: rgb and mask.
@group(0) @binding(3) var<storage, read> photo: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> by_buffers: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> losses: array<accumulator>;

struct BufferGradient {
    normal: vec3f,
    plane: f32,
    coverage: f32,
    metal: f32,
    rough: f32,
}

fn pixel_ix_of(pixel: vec2u) -> u32 {
    return pixel.y * camera.size.x + pixel.x;
}

#ifdef GEOMETRY
// Blended normal and plane distance.
fn plane_at(pixel: vec2u) -> vec4f {
    return gbuffer[NORMAL_GROUP * camera.n_pixels + pixel_ix_of(pixel)];
}

// Depth of the pixel's plane: `t = D / (N . ray)` along the unnormalised ray, or 0.
fn plane_depth(pixel: vec2u, ray: vec3f) -> f32 {
    if channel_coverage(gbuffer[pixel_ix_of(pixel)]) < TRUSTED_COVERAGE {
        return 0.0;
    }
    let plane = plane_at(pixel);
    let facing = dot(plane.xyz, ray);
    let t = plane.w / facing;
    // Grazing planes have no usable depth.
    return select(0.0, t, facing < -0.05 && t > 0.0 && t < 1e4);
}

// One pixel's share `weight coverage (1 - n . n_d)`, its gradients by its own normal and coverage and by the plane depths
// of itself, its right and its lower neighbour.
struct Consistency {
    loss: f32,
    by_normal: vec3f,
    by_coverage: f32,
    by_depth: vec3f,
}

fn consistency(pixel: vec2u) -> Consistency {
    var out: Consistency;
    if pixel.x + 1u >= camera.size.x || pixel.y + 1u >= camera.size.y {
        return out;
    }
    let ray = pixel_ray(camera, pixel.x, pixel.y);
    let ray_right = pixel_ray(camera, pixel.x + 1u, pixel.y);
    let ray_down = pixel_ray(camera, pixel.x, pixel.y + 1u);
    let t = vec3f(
        plane_depth(pixel, ray),
        plane_depth(pixel + vec2u(1u, 0u), ray_right),
        plane_depth(pixel + vec2u(0u, 1u), ray_down),
    );
    if !all(t > vec3f(0.0)) || any(abs(t - t.x) > vec3f(MAX_DEPTH_STEP * t.x)) {
        return out;
    }
    let point = t.x * ray;
    let right = t.y * ray_right - point;
    let down = t.z * ray_down - point;
    // In an OpenCV image, right x down points away from the camera.
    let facing = cross(down, right);
    let length = length3(facing);
    let towards = facing / length;
    let raw = plane_at(pixel).xyz;
    let normal_length = length3(raw);
    let normal = raw / normal_length;
    let coverage = channel_coverage(gbuffer[pixel_ix_of(pixel)]);
    let aligned = dot(normal, towards);
    let weight = weights.depth_normal;
    let by_towards = normalised3_backward(towards, length, -weight * coverage * normal);
    // d (down x right): by down = right x g, by right = g x down.
    let by_down = cross(right, by_towards);
    let by_right = cross(by_towards, down);
    out.loss = weight * coverage * (1.0 - aligned);
    out.by_normal = normalised3_backward(normal, normal_length, -weight * coverage * towards);
    out.by_coverage = weight * (1.0 - aligned);
    out.by_depth = vec3f(dot(-by_down - by_right, ray), dot(by_right, ray_right), dot(by_down, ray_down));
    return out;
}

// Adds the depth-normal term's gradient at `pixel`; returns its value.
fn add_consistency(pixel: vec2u, out: ptr<function, BufferGradient>) -> f32 {
    let own = consistency(pixel);
    (*out).coverage += own.by_coverage;
    (*out).normal += own.by_normal;
    var by_depth = own.by_depth.x;
    if pixel.x > 0u {
        by_depth += consistency(pixel - vec2u(1u, 0u)).by_depth.y;
    }
    if pixel.y > 0u {
        by_depth += consistency(pixel - vec2u(0u, 1u)).by_depth.z;
    }
    if by_depth != 0.0 {
        let ray = pixel_ray(camera, pixel.x, pixel.y);
        let facing = dot(plane_at(pixel).xyz, ray);
        (*out).plane += by_depth / facing;
        (*out).normal -= by_depth * plane_depth(pixel, ray) / facing * ray;
    }
    return own.loss;
}
#endif

#ifdef MATERIAL
// Normal, metalness and roughness divided by coverage; zero in empty pixels.
struct Attributes {
    normal: vec3f,
    material: vec2f,
    inverse: f32,
}

fn attributes_at(pixel_ix: u32) -> Attributes {
    let coverage = channel_coverage(gbuffer[pixel_ix]);
    let inverse = select(0.0, 1.0 / max(coverage, 1e-6), coverage >= MIN_COVERAGE);
    let n = camera.n_pixels;
    return Attributes(
        channel_normal(gbuffer[NORMAL_GROUP * n + pixel_ix]) * inverse,
        vec2f(
            channel_metal(gbuffer[ALBEDO_GROUP * n + pixel_ix]),
            channel_rough(gbuffer[ROUGH_GROUP * n + pixel_ix]),
        ) * inverse,
        inverse,
    );
}

// One pair's gradient by this pixel's attributes (normal, metalness, roughness); `loss` is its value.
struct PairGradient {
    normal: vec3f,
    material: vec2f,
    loss: f32,
}

fn pair_term(own_ix: u32, own: Attributes, other_ix: u32, scale: f32) -> PairGradient {
    let other = attributes_at(other_ix);
    let colours = photo_pixel(own_ix, weights.photo_white) - photo_pixel(other_ix, weights.photo_white);
    let edge = dot(abs(colours.xyz), vec3f(1.0)) / 3.0;
    let factor = scale * exp(-edge);
    let by_normal = own.normal - other.normal;
    let by_material = own.material - other.material;
    let derivative_normal = factor * weights.smoothness.z * sign(by_normal);
    let derivative_material = factor * weights.smoothness.xy * sign(by_material);
    let loss = dot(derivative_normal, by_normal) + dot(derivative_material, by_material);
    return PairGradient(derivative_normal, derivative_material, loss);
}

// Adds the smoothness term's gradient at `pixel`; returns the value of its pairs to the right and below.
fn add_smoothness(pixel: vec2u, out: ptr<function, BufferGradient>) -> f32 {
    let own_ix = pixel_ix_of(pixel);
    let own = attributes_at(own_ix);
    var loss = 0.0;
    var by_normal = vec3f(0.0);
    var by_material = vec2f(0.0);
    // Left, right, up, down.
    for (var side = 0u; side < 4u; side++) {
        let ahead = (side & 1u) == 1u;
        let across = side < 2u;
        let place = select(pixel.y, pixel.x, across);
        let last = select(camera.size.y, camera.size.x, across) - 1u;
        if select(place == 0u, place >= last, ahead) {
            continue;
        }
        let step = select(camera.size.x, 1u, across);
        let scale = select(weights.down, weights.across, across);
        let by = pair_term(own_ix, own, select(own_ix - step, own_ix + step, ahead), scale);
        by_normal += by.normal;
        by_material += by.material;
        loss += select(0.0, by.loss, ahead);
    }
    (*out).normal += by_normal * own.inverse;
    (*out).metal += by_material.x * own.inverse;
    (*out).rough += by_material.y * own.inverse;
    (*out).coverage -= (dot(by_normal, own.normal) + dot(by_material, own.material)) * own.inverse;
    return loss;
}
#endif

// Computes the gradients of one pixel; returns the values of its terms in the order of the slots.
fn pixel_terms(pixel: vec2u) -> vec4f {
    let pixel_ix = pixel_ix_of(pixel);
    var out: BufferGradient;
    var values = vec4f(0.0);
    let difference = channel_coverage(gbuffer[pixel_ix]) - photo_pixel(pixel_ix, weights.photo_white).w;
    values.x = weights.coverage * abs(difference);
    out.coverage += weights.coverage * sign(difference);
#ifdef GEOMETRY
    if weights.depth_normal != 0.0 {
        values.y = add_consistency(pixel, &out);
    }
#endif
#ifdef MATERIAL
    if any(weights.smoothness != vec3f(0.0)) {
        values.z = add_smoothness(pixel, &out);
    }
#endif
    by_buffers[pixel_ix] = vec4f(out.normal, out.plane);
    by_buffers[camera.n_pixels + pixel_ix] = vec4f(out.coverage, out.metal, out.rough, 0.0);
    return values;
}

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(local_invocation_index) local_ix: u32) {
    var values = vec4f(0.0);
    if gid.x < camera.size.x && gid.y < camera.size.y {
        values = pixel_terms(gid.xy);
    }
    let total = workgroup_sum(local_ix, values);
    if local_ix == 0u {
        accumulate!(losses[LOSS_COVERAGE], total.x);
        accumulate!(losses[LOSS_DEPTH_NORMAL], total.y);
        accumulate!(losses[LOSS_SMOOTHNESS], total.z);
    }
}
