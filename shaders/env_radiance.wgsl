// Radiance of the environment from its raw texels (softplus), the terms of the objective on it, and the values for their
// gradients (docs/MODEL.md, section 5: light neutrality, exposure, colour).
// One workgroup processes all texels, since two terms need sums over them and there are a few thousand at most. A thread
// owns every 256th texel.
const WG_SIZE = 256u;
#import environment
#import generated/level
#import generated/slots
#import reduce

@group(0) @binding(0) var<uniform> environment: Environment;
// Raw prototypes, then raw texels.
@group(0) @binding(1) var<storage, read> globals: array<f32>;
// Contribution of a texel to the irradiance of a surface facing up, divided by pi.
@group(0) @binding(2) var<storage, read> upward: array<f32>;
@group(0) @binding(3) var<storage, read_write> radiance: array<f32>;
// The radiance rotated about +Z, as in the photograph.
@group(0) @binding(6) var<storage, read_write> turned: array<f32>;
// Derivatives of exposure and colour by the irradiance from above, per channel.
@group(0) @binding(4) var<storage, read_write> light_derivative: array<f32>;
@group(0) @binding(5) var<storage, read_write> losses: array<accumulator>;

fn softplus(x: f32) -> f32 {
    return max(x, 0.0) + log(1.0 + exp(-abs(x)));
}

fn beyond_tolerance(distance: f32) -> f32 {
    return distance - clamp(distance, -environment.tolerance, environment.tolerance);
}

fn texel(texel_ix: u32) -> vec3f {
    let first = environment.first_texel + 3u * texel_ix;
    return vec3f(softplus(globals[first]), softplus(globals[first + 1u]), softplus(globals[first + 2u]));
}

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(local_invocation_index) local_ix: u32) {
    // Irradiance from above, sum of deviations from grey.
    var sums = vec4f(0.0);
    for (var texel_ix = local_ix; texel_ix < environment.n_texels; texel_ix += WG_SIZE) {
        let light = texel(texel_ix);
        var as_stood = light;
        if environment.whole != 0u || environment.fraction != 0.0 {
            let near = texel(texel_beside(texel_ix, environment.whole, environment.width));
            let far = texel(texel_beside(texel_ix, environment.whole + 1u, environment.width));
            as_stood = (1.0 - environment.fraction) * near + environment.fraction * far;
        }
        for (var c = 0u; c < 3u; c++) {
            radiance[3u * texel_ix + c] = light[c];
            turned[3u * texel_ix + c] = as_stood[c];
        }
        let grey = (light.r + light.g + light.b) / 3.0;
        let deviation = abs(light - grey);
        sums += vec4f(upward[texel_ix] * light, deviation.r + deviation.g + deviation.b);
    }
    sums = workgroup_sum(local_ix, sums);
    if local_ix == 0u {
        let above = max(sums.rgb, vec3f(1e-6));
        let up = max(dot(LUMINANCE, sums.rgb), 1e-6);
        let level = log(up / UPWARD_LUMINANCE);
        let blue = beyond_tolerance(log(above.b / above.r) - environment.blue_over_red);
        let green = beyond_tolerance(log(above.g * above.g / (above.r * above.b)) - environment.green);
        let by_level = (2.0 * environment.exposure * level / up) * LUMINANCE;
        let by_colour = 2.0 * environment.colour * vec3f(-blue - green, 2.0 * green, blue - green) / above;
        for (var c = 0u; c < 3u; c++) {
            light_derivative[c] = by_level[c] + by_colour[c];
        }
        accumulate!(losses[LOSS_NEUTRALITY], environment.neutrality * sums.w);
        let values = environment.exposure * level * level + environment.colour * (blue * blue + green * green);
        accumulate!(losses[LOSS_EXPOSURE], values);
    }
}
