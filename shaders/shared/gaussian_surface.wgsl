// A Gaussian as a surface: normal and material from its attribute row, light from its parameters. The importer binds `model`,
// `params`, `splats`, `attributes` (as vec4), and the bindings of `incoming`. With ALL_CHANNELS the rows have all channels,
// else those up to material.
#import surface
#import splat
#import quaternion
#import incoming

#ifdef ALL_CHANNELS
const ROW_GROUPS = VISIBILITY_GROUP + N_QUADS;
#else
const ROW_GROUPS = GROUPS_MATERIAL;
#endif

// Vector from the camera centre to the Gaussian's centre.
fn to_gaussian(gaussian_ix: u32) -> vec3f {
    let at = model.mean + 3u * gaussian_ix;
    return vec3f(params[at], params[at + 1u], params[at + 2u]) - camera.centre.xyz;
}

fn gaussian_surface(gaussian_ix: u32) -> Surface {
    let row = gaussian_ix * ROW_GROUPS;
    let incident = incident_light(gaussian_ix);
    var s = surface_of_channels(
        attributes[row + NORMAL_GROUP],
        attributes[row + ALBEDO_GROUP],
        channel_rough(attributes[row + ROUGH_GROUP]),
        incident.gathered,
        incident.blocked,
        1.0,
        -normalised3(to_gaussian(gaussian_ix)),
    );
    s.arriving = arriving_at(gaussian_ix, model.n);
    s.sheen = params[model.sheen + gaussian_ix];
    for (var quad = 0u; quad < N_QUADS; quad++) {
        s.visibility[quad] = visibility_quad(gaussian_ix, quad);
    }
    return s;
}

fn is_drawn(gaussian_ix: u32) -> bool {
    return splats[gaussian_ix].flags == SPLAT_VISIBLE && splats[gaussian_ix].n_tiles != 0u;
}
