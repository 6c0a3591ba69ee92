// Irradiance of the sky through the visibility field. The importer binds `model`, `shape`, `params` and `values`.
#import attributes
#import cube_grid
#import generated/light
#import tables

// Dot product of the row of one colour of one node with the Gaussian's visibility.
fn through_visibility(gaussian_ix: u32, row: u32) -> f32 {
    if model.visibility_form == VISIBILITY_OFF {
        return values[row] * UNOCCLUDED_SH0;
    }
    let first = model.visibility + model.n_visibility * gaussian_ix;
    var sum = 0.0;
    for (var k = 0u; k < min(model.n_visibility, shape.coefficients); k++) {
        sum += values[row + k] * params[first + k];
    }
    return sum;
}

// Irradiance at a Gaussian with this finite unit normal.
fn sky_irradiance(gaussian_ix: u32, normal: vec3f) -> vec3f {
    let taps = cube_taps(shape.diffuse_n, normal);
    var sky = vec3f(0.0);
#repeat k 4
    {
        let row = taps.node[$k] * 3u * shape.coefficients;
        sky += taps.weight[$k] * vec3f(
            through_visibility(gaussian_ix, row),
            through_visibility(gaussian_ix, row + shape.coefficients),
            through_visibility(gaussian_ix, row + 2u * shape.coefficients),
        );
    }
#end
    return max(sky, vec3f(0.0));
}
