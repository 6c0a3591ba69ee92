// What is measured of the light of Gaussians. The importer binds `gathered`: irradiance, then mean blocked radiance, six floats
// a Gaussian; behind those of all Gaussians the share of each light beside the tables that arrives, four floats a Gaussian.

// Share of each light that arrives at a Gaussian of `n`; all of it where it was not measured.
fn arriving_at(gaussian_ix: u32, n: u32) -> vec4f {
    let at = 6u * n + 4u * gaussian_ix;
    if at + 4u > arrayLength(&gathered) {
        return vec4f(1.0);
    }
    return vec4f(gathered[at], gathered[at + 1u], gathered[at + 2u], gathered[at + 3u]);
}
