// The BRDF of the surface in a pixel of a full G-buffer, which the importer binds as `gbuffer`, with `constants` as `brdf` reads them; for coverage >= MIN_COVERAGE.
#import camera
#import generated/channels
#import reflector

fn pixel_reflector(pixel_ix: u32, coverage: f32, ray: vec3f, conserves_energy: bool) -> Reflector {
    let n = camera.n_pixels;
    let inverse = 1.0 / coverage;
    let material = gbuffer[ALBEDO_GROUP * n + pixel_ix] * inverse;
    return reflector_of(
        channel_normal(gbuffer[NORMAL_GROUP * n + pixel_ix]),
        -normalised3(ray),
        channel_albedo(material),
        channel_metal(material),
        channel_rough(gbuffer[ROUGH_GROUP * n + pixel_ix]) * inverse,
        conserves_energy,
    );
}
