// Radiance of the environment from its raw texels (softplus), the terms of the objective on it, and what their gradients
// need (docs/MODEL.md section 5: light neutrality, exposure).
// One workgroup walks all texels, since the exposure term needs a sum over them and there are few thousand at most; a
// thread owns every 256th texel. Workgroup memory holds the partial sums of the reduction.
const WG_SIZE = 256u;
#import environment
#import losses

@group(0) @binding(0) var<uniform> environment: Environment;
// Raw prototypes, then raw texels.
@group(0) @binding(1) var<storage, read> globals: array<f32>;
// What a texel adds to the mean irradiance of a surface facing up, divided by pi.
@group(0) @binding(2) var<storage, read> upward: array<f32>;
@group(0) @binding(3) var<storage, read_write> radiance: array<f32>;
// Slope of the exposure term by `up`.
@group(0) @binding(4) var<storage, read_write> exposure_slope: array<f32>;
@group(0) @binding(5) var<storage, read_write> losses: array<accumulator>;

var<workgroup> sh_sums: array<vec2f, WG_SIZE>;

fn softplus(x: f32) -> f32 {
    return max(x, 0.0) + log(1.0 + exp(-abs(x)));
}

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(local_invocation_index) local_ix: u32) {
    // Sum of deviations from grey, irradiance from above.
    var sums = vec2f(0.0);
    for (var texel_ix = local_ix; texel_ix < environment.n_texels; texel_ix += WG_SIZE) {
        let first = environment.first_texel + 3u * texel_ix;
        let light = vec3f(softplus(globals[first]), softplus(globals[first + 1u]), softplus(globals[first + 2u]));
        for (var c = 0u; c < 3u; c++) {
            radiance[3u * texel_ix + c] = light[c];
        }
        let grey = (light.r + light.g + light.b) / 3.0;
        let deviation = abs(light - grey);
        sums += vec2f(deviation.r + deviation.g + deviation.b, upward[texel_ix] * 3.0 * grey);
    }
    sh_sums[local_ix] = sums;
    for (var width = WG_SIZE / 2u; width > 0u; width /= 2u) {
        workgroupBarrier();
        if local_ix < width {
            sh_sums[local_ix] += sh_sums[local_ix + width];
        }
    }
    if local_ix == 0u {
        let up = max(sh_sums[0].y, 1e-6);
        let level = log(up);
        exposure_slope[0] = 2.0 * environment.exposure * level / up;
        accumulate!(losses[LOSS_NEUTRALITY], environment.neutrality * sh_sums[0].x);
        accumulate!(losses[LOSS_EXPOSURE], environment.exposure * level * level);
    }
}
