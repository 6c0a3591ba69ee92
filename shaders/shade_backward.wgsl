// Gradients of the G-buffer and of the light tables from the gradients of both images and of the buffers. A thread owns a
// pixel of a 16 x 16 square and writes BY_GROUPS groups of its G-buffer gradient (4: Material; all with ALL_CHANNELS).
//
// shared/table_shares.wgsl adds the pixels' gradients of the tables: the diffuse table, then the two specular levels.
const WG_SIZE = 256u;
#import shading_backward
#import pixel_surface
#import table_shares

@group(0) @binding(6) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(7) var<storage, read> by_physical: array<vec4f>;
@group(0) @binding(8) var<storage, read> by_radiance: array<vec4f>;
// See surface_terms.wgsl.
@group(0) @binding(9) var<storage, read> by_buffers: array<vec4f>;
@group(0) @binding(10) var<storage, read_write> by_gbuffer: array<vec4f>;
@group(0) @binding(11) var<storage, read_write> by_tables: array<accumulator>;

// The first pixel of the square.
var<private> origin: vec2u;

// Group `quad` of the visibility of thread `local_ix` of the square.
fn member_visibility(local_ix: u32, quad: u32) -> vec4f {
    let pixel = origin + vec2u(local_ix % 16u, local_ix / 16u);
    return pixel_visibility(pixel.y * camera.size.x + pixel.x, quad, sh_by[local_ix].w);
}

// Writes one pixel's G-buffer gradient; returns its shares of the gradient of the tables.
fn pixel_backward(pixel: vec2u) -> Shares {
    var shares = no_shares();
    let n = camera.n_pixels;
    let pixel_ix = pixel.y * camera.size.x + pixel.x;
    let coverage = channel_coverage(gbuffer[pixel_ix]);
    let g = by_physical[pixel_ix].xyz;
    let g_radiance = by_radiance[pixel_ix].xyz;
    let on_geometry = by_buffers[pixel_ix];
    let on_material = by_buffers[n + pixel_ix];
    var by_coverage = on_material.x - dot(g_radiance, shading.background.xyz);
    var inverse = 0.0;
    var by: SurfaceGradient;
    if coverage >= MIN_COVERAGE {
        inverse = 1.0 / coverage;
        var s = pixel_surface(pixel, pixel_ix, coverage);
        var f = shade(&s);
        let linear = f.diffuse + f.specular;
        let is_srgb = shading.srgb != 0u;
        by_coverage += dot(g, display(linear, is_srgb, shading.peak) - shading.background.xyz);
        let by_linear = display_backward(linear, g * coverage, is_srgb, shading.peak);
        by = shade_backward(&s, &f, by_linear);
        // Attributes are buffers divided by coverage.
        let along = dot(by.normal, s.normal) + dot(by.albedo, s.albedo) + dot(by.gathered, s.gathered)
            + dot(by.blocked, s.blocked) + by.metal * s.metal + by.rough * s.rough + by.along_visibility;
        by_coverage -= along * inverse;
        shares = shares_of(&f, &by, inverse);
    } else {
        by_coverage -= dot(g, shading.background.xyz);
    }
    by_gbuffer[pixel_ix] = vec4f(by_coverage, g_radiance);
    by_gbuffer[NORMAL_GROUP * n + pixel_ix] = vec4f(by.normal * inverse + on_geometry.xyz, on_geometry.w);
    by_gbuffer[ALBEDO_GROUP * n + pixel_ix] = vec4f(by.albedo, by.metal) * inverse + vec4f(0.0, 0.0, 0.0, on_material.y);
    let by_rough = by.rough * inverse + on_material.z;
    by_gbuffer[ROUGH_GROUP * n + pixel_ix] = vec4f(by_rough, by.gathered * inverse);
#ifdef ALL_CHANNELS
    by_gbuffer[DEPTH_GROUP * n + pixel_ix] = vec4f(0.0, by.blocked * inverse);
    for (var quad = 0u; quad < N_QUADS; quad++) {
        by_gbuffer[(VISIBILITY_GROUP + quad) * n + pixel_ix] = by.visibility[quad] * inverse;
    }
#endif
    return shares;
}

@compute @workgroup_size(16, 16)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(workgroup_id) wid: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    var shares = no_shares();
    if gid.x < camera.size.x && gid.y < camera.size.y {
        shares = pixel_backward(gid.xy);
    }
    origin = 16u * wid.xy;
    add_all_shares(local_ix, &shares);
}
