// A Gaussian as a surface of its own, from its row of all channels. The importer binds `model`, `params`, `splats` and
// `attributes`, the latter as vec4.
#import surface
#import splat
#import quaternion

// Group `quad` of its visibility.
fn gaussian_visibility(gaussian_ix: u32, quad: u32) -> vec4f {
    return masked_quad(quad, attributes[gaussian_ix * (VISIBILITY_GROUP + N_QUADS) + VISIBILITY_GROUP + quad]);
}

fn gaussian_surface(gaussian_ix: u32) -> Surface {
    let at = model.mean + 3u * gaussian_ix;
    let mean = vec3f(params[at], params[at + 1u], params[at + 2u]);
    let row = gaussian_ix * (VISIBILITY_GROUP + N_QUADS);
    var s = surface_of_groups(
        attributes[row + 1u],
        attributes[row + 2u],
        attributes[row + 3u],
        attributes[row + 4u],
        1.0,
        normalised3(view.eye.xyz - mean),
    );
    for (var quad = 0u; quad < N_QUADS; quad++) {
        s.visibility[quad] = gaussian_visibility(gaussian_ix, quad);
    }
    return s;
}

// The unit normal of a Gaussian, turned to the camera.
fn facing_normal(s: ptr<function, Surface>) -> vec3f {
    return select((*s).normal, -(*s).normal, dot((*s).normal, (*s).view) < 0.0);
}

fn is_drawn(gaussian_ix: u32) -> bool {
    return splats[gaussian_ix].flags == SPLAT_VISIBLE && splats[gaussian_ix].n_tiles != 0u;
}
