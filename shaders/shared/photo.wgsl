// A photograph, which the importer binds as `photo`: red and green, then blue and mask, in 16 bits each. `white` is the colour of
// the highest level. Kept in step with `PhotoPixel` of crates/engine/src/gpu/photo_pixel.rs.
fn photo_pixel(pixel_ix: u32, white: f32) -> vec4f {
    let pixel = photo[pixel_ix];
    return vec4f(unpack2x16unorm(pixel.x), unpack2x16unorm(pixel.y)) * vec4f(vec3f(white), 1.0);
}
