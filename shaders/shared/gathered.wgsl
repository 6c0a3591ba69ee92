// Light that other Gaussians send to each Gaussian: irradiance, then mean blocked radiance, six floats. The importer binds it as
// `gathered`, shorter where nothing was gathered, and the model's `Layout` as `model`.
#import parameters

fn has_gathered(gaussian_ix: u32) -> bool {
    return model.indirect_form == INDIRECT_GATHERED && 6u * gaussian_ix + 6u <= arrayLength(&gathered);
}

fn gathered_vec3(at: u32) -> vec3f {
    return vec3f(gathered[at], gathered[at + 1u], gathered[at + 2u]);
}
