// The surface in a pixel of a full G-buffer of blended attributes, which the importer binds as `gbuffer`.
#import surface
#import camera
#import quaternion

// Group `quad` of the visibility in a pixel, divided by coverage.
fn pixel_visibility(pixel_ix: u32, quad: u32, inverse: f32) -> vec4f {
    return masked_quad(quad, gbuffer[(VISIBILITY_GROUP + quad) * camera.n_pixels + pixel_ix] * inverse);
}

// The surface in a pixel with coverage >= MIN_COVERAGE.
fn pixel_surface(pixel: vec2u, pixel_ix: u32, coverage: f32) -> Surface {
    let n = camera.n_pixels;
    let inverse = 1.0 / coverage;
    var s = surface_of_channels(
        gbuffer[NORMAL_GROUP * n + pixel_ix],
        gbuffer[ALBEDO_GROUP * n + pixel_ix],
        channel_rough(gbuffer[ROUGH_GROUP * n + pixel_ix]),
        channel_gathered(gbuffer[ROUGH_GROUP * n + pixel_ix]),
        channel_blocked(gbuffer[DEPTH_GROUP * n + pixel_ix]),
        inverse,
        -normalised3(pixel_ray(camera, pixel.x, pixel.y)),
    );
    for (var quad = 0u; quad < N_QUADS; quad++) {
        s.visibility[quad] = pixel_visibility(pixel_ix, quad, inverse);
    }
    return s;
}
