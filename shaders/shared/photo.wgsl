// A photograph, which the importer binds as `photo`: red and green, then blue and mask, in 16 bits each. Kept in step with
// `PhotoPixel` of crates/engine/src/gpu/photo_pixel.rs.
fn photo_pixel(pixel_ix: u32) -> vec4f {
    let pixel = photo[pixel_ix];
    return vec4f(unpack2x16unorm(pixel.x), unpack2x16unorm(pixel.y));
}
