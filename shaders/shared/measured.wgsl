// Measured light of Gaussians. The importer binds `gathered`: six floats per Gaussian (irradiance, mean blocked radiance),
// followed, after all Gaussians, by the arriving shares of the dominant lights, four floats per Gaussian.

// Arriving share of each dominant light at one of `n` Gaussians; 1 where it was not measured.
fn arriving_at(gaussian_ix: u32, n: u32) -> vec4f {
    let at = 6u * n + 4u * gaussian_ix;
    if at + 4u > arrayLength(&gathered) {
        return vec4f(1.0);
    }
    return vec4f(gathered[at], gathered[at + 1u], gathered[at + 2u], gathered[at + 3u]);
}
