//! Textures of a quad mesh: every quad has its own square of texels. The sides of the textures are powers of two.

use glam::Vec3;
use rayon::prelude::*;

use crate::render::mesh::surface::QuadMesh;
use crate::render::mesh::views::DepthView;
use relume_capture::formats::ImageFileError;
use relume_capture::formats::gltf::TexturedMesh;
use relume_capture::formats::image_file::encode_png;
use relume_scene::{Output, srgb};

/// Texels along the side of a quad's square. The quad's corners lie at the centres of the outermost texels, so that
/// interpolation stays inside the square.
const SIDE: usize = 4;
/// Greatest side of a texture, texels.
const MAX_TEXTURE_SIDE: usize = 8192;
/// Cosine between surface normal and view direction below which a view is ignored.
const MIN_COSINE: f32 = 0.2;

/// Weighted sums over the views of a texel.
#[derive(Debug, Clone, Copy, Default)]
struct Texel {
    place: Vec3,
    facing: Vec3,
    weight: f32,
    normal: Vec3,
    /// Albedo, metalness, roughness.
    material: [f32; 5],
}

pub(super) struct Atlas {
    /// Texels quad by quad, `SIDE * SIDE` each.
    texels: Vec<Texel>,
    /// Number of squares in a row of the texture.
    columns: usize,
}

impl Atlas {
    /// `None` if the texture would be too large.
    pub(super) fn new(surface: &QuadMesh) -> Option<Self> {
        let columns = ((surface.quads.len() as f64).sqrt().ceil() as usize).next_power_of_two();
        let texels = surface.quads.iter().flat_map(|quad| {
            let [a, b, c, d] = quad.map(|v| surface.vertices[v as usize]);
            let facing = (c - a).cross(d - b).normalize_or_zero();
            (0..SIDE * SIDE).map(move |k| {
                let [u, v] = [k % SIDE, k / SIDE].map(|t| t as f32 / (SIDE - 1) as f32);
                Texel { place: a.lerp(b, u).lerp(d.lerp(c, u), v), facing, ..Texel::default() }
            })
        });
        (columns * SIDE <= MAX_TEXTURE_SIDE).then(|| Self { texels: texels.collect(), columns })
    }

    /// Adds the materials that a view shows at visible texels: those within `tolerance` of the view's depth.
    pub(super) fn add(&mut self, view: &DepthView, tolerance: f32) {
        let plane = |output| view.frame.planes.get(&output).map_or(&[][..], Vec::as_slice);
        let (albedo, normals) =
            (plane(Output::Albedo).as_chunks::<3>().0, plane(Output::Normal).as_chunks::<3>().0);
        let (metallic, roughness) = (plane(Output::Metallic), plane(Output::Roughness));
        self.texels.par_iter_mut().with_min_len(1024).for_each(|texel| {
            let cosine = texel.facing.dot(view.towards(texel.place));
            let Some(seen) = view.find(texel.place).filter(|_| cosine > MIN_COSINE) else { return };
            if (seen.depth - seen.z).abs() > tolerance {
                return;
            }
            let (i, weight) = (seen.pixel, cosine * cosine);
            let [r, g, b] = albedo[i];
            texel.weight += weight;
            texel.normal += weight * Vec3::from(normals[i]);
            let shown = [r, g, b, metallic[i], roughness[i]];
            texel.material.iter_mut().zip(shown).for_each(|(sum, v)| *sum += weight * v);
        });
    }

    /// The mesh with its textures; `to_capture` transforms points to capture coordinates.
    pub(super) fn into_mesh(
        self,
        surface: &QuadMesh,
        to_capture: impl Fn(Vec3) -> Vec3,
    ) -> Result<TexturedMesh, ImageFileError> {
        let rows = surface.quads.len().div_ceil(self.columns);
        let (width, height) = (self.columns * SIDE, (rows * SIDE).next_power_of_two());
        let mut base_colour = vec![[0u8; 3]; width * height];
        let mut metallic_roughness = vec![[0u8; 3]; width * height];
        let mut out = TexturedMesh::default();
        let everywhere = mean(&self.texels).unwrap_or([0.5, 0.5, 0.5, 0.0, 0.5]);
        for (q, (quad, square)) in surface.quads.iter().zip(self.texels.chunks_exact(SIDE * SIDE)).enumerate()
        {
            let (column, row) = (q % self.columns * SIDE, q / self.columns * SIDE);
            let here = mean(square).unwrap_or(everywhere);
            for (k, texel) in square.iter().enumerate() {
                let [r, g, b, metallic, roughness] = mean(std::slice::from_ref(texel)).unwrap_or(here);
                let at = (row + k / SIDE) * width + column + k % SIDE;
                base_colour[at] = [r, g, b].map(|v| srgb::to_u8(srgb::encode(v)));
                metallic_roughness[at] = [1.0, roughness, metallic].map(|v| srgb::to_u8(v.clamp(0.0, 1.0)));
            }
            let first = out.positions.len() as u32;
            for (corner, [i, j]) in
                quad.iter().zip([[0, 0], [SIDE - 1, 0], [SIDE - 1, SIDE - 1], [0, SIDE - 1]])
            {
                let texel = &square[j * SIDE + i];
                out.positions.push(to_capture(surface.vertices[*corner as usize]));
                out.normals.push(texel.normal.try_normalize().unwrap_or(texel.facing));
                let texture = [(column + i, width), (row + j, height)];
                out.texture_coordinates.push(texture.map(|(at, of)| (at as f32 + 0.5) / of as f32));
            }
            out.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|k: u32| first + k)));
        }
        out.base_colour = encode_png(width as u32, height as u32, &base_colour)?;
        out.metallic_roughness = encode_png(width as u32, height as u32, &metallic_roughness)?;
        Ok(out)
    }
}

/// Mean material of texels; `None` if no view shows them.
fn mean(texels: &[Texel]) -> Option<[f32; 5]> {
    let weight: f32 = texels.iter().map(|t| t.weight).sum();
    (weight > 0.0)
        .then(|| std::array::from_fn(|k| texels.iter().map(|t| t.material[k]).sum::<f32>() / weight))
}
