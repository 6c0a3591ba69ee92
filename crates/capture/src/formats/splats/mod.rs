//! Gaussians in the form that splat programs read: shape, opacity, colour as spherical harmonics, and additionally
//! the material. All writers of splat files start from this form.

mod low_pass;
mod y_up;

use glam::{DQuat, DVec3, Vec3};

use relume_scene::{Field, Model, NormalForm, sh_count, srgb};

/// Highest SH degree of the colour in splat files.
pub const MAX_SPLAT_SH_DEGREE: usize = 3;
/// Value of the SH basis function of degree 0.
pub(super) const Y_0: f32 = 0.282_094_8;
/// Largest magnitude of the logarithm of a standard deviation, so that the deviation itself is a positive f32.
const MAX_LOG_SCALE: f32 = 80.0;

/// A surface property that a splat file can show as colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layer {
    /// Base colour, sRGB-encoded.
    Albedo,
    /// `n / 2 + 1/2` of the shading normal in the file's axes.
    Normal,
    /// Roughness as grey.
    Roughness,
    /// Metalness as grey.
    Metallic,
}

/// Material of a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SplatMaterial {
    /// Base colour, linear Rec.709, 0 to 1.
    pub albedo: [f32; 3],
    /// Metalness, 0 to 1.
    pub metallic: f32,
    /// Roughness, 0 to 1.
    pub roughness: f32,
}

/// Gaussians of a model in capture coordinates. Every list has one entry per Gaussian.
#[derive(Debug, Clone, PartialEq)]
pub struct Splats {
    /// Centres, capture units.
    pub positions: Vec<Vec3>,
    /// Unit orientations.
    pub rotations: Vec<DQuat>,
    /// Natural logarithms of the standard deviations along the three axes, capture units.
    pub log_scales: Vec<[f32; 3]>,
    /// Opacities before the sigmoid.
    pub opacity_logits: Vec<f32>,
    /// SH degree of the colour, at most [`MAX_SPLAT_SH_DEGREE`].
    pub degree: usize,
    /// `(degree + 1)^2` coefficients per Gaussian, index `l * l + l + m`: SH of the sRGB-encoded colour minus 1/2, by
    /// the direction from the camera.
    pub harmonics: Vec<[f32; 3]>,
    /// Unit shading normals; zero if the model has none.
    pub normals: Vec<Vec3>,
    /// Materials.
    pub materials: Vec<SplatMaterial>,
}

impl Splats {
    /// The Gaussians of a checked model with the colour of its radiance branch. Degrees above [`MAX_SPLAT_SH_DEGREE`]
    /// are left out.
    pub fn of(model: &Model) -> Self {
        let g = &model.gaussians;
        let every = 0..g.len();
        let degree = g.radiance_degree().min(MAX_SPLAT_SH_DEGREE);
        let shrink = model.world_scale.ln() as f32;
        let harmonics = |i| g.row(Field::Radiance, i).as_chunks::<3>().0[..sh_count(degree)].iter().copied();
        Self {
            positions: every.clone().map(|i| position(model, i)).collect(),
            rotations: every.clone().map(|i| orientation(model, i)).collect(),
            log_scales: every.clone().map(|i| g.get(Field::LogScale, i).map(|s: f32| s - shrink)).collect(),
            opacity_logits: g.field(Field::OpacityLogit).to_vec(),
            degree,
            harmonics: every.clone().flat_map(harmonics).collect(),
            normals: every.clone().map(|i| normal(model, i)).collect(),
            materials: every.map(|i| material(model, i)).collect(),
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// True without Gaussians.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Standard deviations of Gaussian `i`, positive and finite.
    pub fn scale(&self, i: usize) -> [f32; 3] {
        self.log_scales[i].map(|s| s.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp())
    }

    /// Opacity of Gaussian `i`, 0 to 1.
    pub fn opacity(&self, i: usize) -> f32 {
        sigmoid(self.opacity_logits[i])
    }

    /// Coefficients of Gaussian `i`.
    pub fn harmonics(&self, i: usize) -> &[[f32; 3]] {
        let count = sh_count(self.degree);
        &self.harmonics[i * count..(i + 1) * count]
    }

    /// Mean colour of Gaussian `i` over all directions, linear Rec.709, 0 to 1.
    pub fn mean_colour(&self, i: usize) -> [f32; 3] {
        self.harmonics(i)[0].map(|c| srgb::decode(0.5 + Y_0 * c))
    }

    /// Copies with a surface property as colour, equal in all directions.
    #[must_use]
    pub fn painted(mut self, layer: Layer) -> Self {
        let shown = |i: usize| {
            let material = &self.materials[i];
            match layer {
                Layer::Albedo => material.albedo.map(srgb::encode),
                Layer::Normal => self.normals[i].to_array().map(|n| 0.5 + 0.5 * n),
                Layer::Roughness => [material.roughness; 3],
                Layer::Metallic => [material.metallic; 3],
            }
        };
        self.harmonics = (0..self.len()).map(|i| shown(i).map(|c| (c - 0.5) / Y_0)).collect();
        self.degree = 0;
        self
    }

    /// Copies with every Gaussian rotated by the smallest angle that makes its shortest axis the shading normal.
    /// Programs without normals use that axis as the normal.
    #[must_use]
    pub fn flattened(mut self) -> Self {
        for ((rotation, scales), normal) in self.rotations.iter_mut().zip(&self.log_scales).zip(&self.normals)
        {
            let normal = normal.as_dvec3();
            if normal.length() < 0.5 {
                continue;
            }
            let axis = *rotation * shortest_axis(*scales);
            let towards = if axis.dot(normal) < 0.0 { -normal } else { normal };
            *rotation =
                (DQuat::from_rotation_arc(axis.normalize(), towards.normalize()) * *rotation).normalize();
        }
        self
    }
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

fn position(model: &Model, i: usize) -> Vec3 {
    let mean = DVec3::from(model.gaussians.get::<3>(Field::Mean, i).map(f64::from));
    (mean / model.world_scale - model.world_offset).as_vec3()
}

/// Unit orientation; the identity for a quaternion of length 0.
fn orientation(model: &Model, i: usize) -> DQuat {
    let [w, x, y, z] = model.gaussians.get::<4>(Field::Quaternion, i).map(f64::from);
    let q = DQuat::from_xyzw(x, y, z, w);
    if q.length() > 1e-12 { q.normalize() } else { DQuat::IDENTITY }
}

fn material(model: &Model, i: usize) -> SplatMaterial {
    let g = &model.gaussians;
    SplatMaterial {
        albedo: albedo(model, i),
        metallic: sigmoid(g.row(Field::MetalLogit, i)[0]),
        roughness: sigmoid(g.row(Field::RoughLogit, i)[0]),
    }
}

/// The mixture of prototypes plus the residual, in [0, 1].
pub(super) fn albedo(model: &Model, i: usize) -> [f32; 3] {
    let logits = model.gaussians.row(Field::ProtoLogits, i);
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let weights: Vec<f32> = logits.iter().map(|l| (l - largest).exp()).collect();
    let total: f32 = weights.iter().sum::<f32>().max(f32::MIN_POSITIVE);
    let residual = model.gaussians.row(Field::Residual, i);
    std::array::from_fn(|c| {
        let mixed = weights.iter().zip(&model.prototypes).map(|(w, p)| w * p[c].clamp(0.0, 1.0));
        (mixed.sum::<f32>() / total + residual[c]).clamp(0.0, 1.0)
    })
}

/// The shading normal. A renderer flips the shortest axis towards its camera; a file has no camera, so the axis
/// points to its outward side.
fn normal(model: &Model, i: usize) -> Vec3 {
    let g = &model.gaussians;
    let own = Vec3::from(g.get::<3>(Field::Normal, i));
    let sum = match model.shading.normal {
        NormalForm::Free => own,
        NormalForm::ShortestAxis => own + outward_axis(model, i),
    };
    sum.normalize_or_zero()
}

/// The shortest axis on the side where visibility is larger, which the degree-1 part of the visibility field gives.
pub(super) fn outward_axis(model: &Model, i: usize) -> Vec3 {
    let g = &model.gaussians;
    let axis = (orientation(model, i) * shortest_axis(g.get(Field::LogScale, i))).as_vec3();
    let c = g.row(Field::Visibility, i);
    let open = if c.len() >= 4 { Vec3::new(-c[3], -c[1], c[2]) } else { Vec3::ZERO };
    if open.dot(axis) < 0.0 { -axis } else { axis }
}

fn shortest_axis(s: [f32; 3]) -> DVec3 {
    if s[0] <= s[1] && s[0] <= s[2] {
        DVec3::X
    } else if s[1] <= s[2] {
        DVec3::Y
    } else {
        DVec3::Z
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use relume_scene::Gaussians;

    /// Two Gaussians, the second with a value in every field.
    pub(in crate::formats) fn example() -> Model {
        let mut g = Gaussians::zeroed(2, 2, 1, 1);
        g.row_mut(Field::Mean, 1).copy_from_slice(&[1.0, -0.5, 0.25]);
        g.row_mut(Field::LogScale, 1).copy_from_slice(&[-1.0, -2.0, -3.0]);
        g.row_mut(Field::Quaternion, 1).copy_from_slice(&[2.0, 0.0, 0.0, 0.0]);
        g.row_mut(Field::OpacityLogit, 1)[0] = 1.5;
        g.row_mut(Field::ProtoLogits, 1).copy_from_slice(&[0.0, 3f32.ln()]);
        g.row_mut(Field::Residual, 1).copy_from_slice(&[0.1, 0.0, -1.0]);
        g.row_mut(Field::RoughLogit, 1)[0] = 3f32.ln();
        g.row_mut(Field::Visibility, 1).copy_from_slice(&[3.0, 0.0, -1.0, 0.0]);
        let radiance: Vec<f32> = (0..12).map(|k| k as f32).collect();
        g.row_mut(Field::Radiance, 1).copy_from_slice(&radiance);
        Model {
            world_scale: 2.0,
            world_offset: DVec3::new(0.0, 1.0, 0.0),
            ..Model::new(g, vec![[0.2, 0.4, 0.6], [0.6, 0.4, 0.2]], vec![[0.0; 3]; 2], (2, 1))
        }
    }

    #[test]
    fn painted_layers_show_their_quantity_in_every_direction() {
        let shown = |layer| {
            let painted = Splats::of(&example()).painted(layer);
            assert_eq!((painted.degree, painted.harmonics.len()), (0, 2));
            painted.harmonics[1].map(|c| 0.5 + Y_0 * c)
        };
        let near = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(near(shown(Layer::Albedo), [0.6, 0.4, 0.0].map(srgb::encode)));
        assert!(near(shown(Layer::Normal), [0.5, 0.5, 0.0]), "downwards");
        assert!(near(shown(Layer::Roughness), [0.75; 3]));
        assert!(near(shown(Layer::Metallic), [0.5; 3]));
    }

    #[test]
    fn flattening_only_rotates_the_shortest_axis_to_the_normal() {
        let mut model = example();
        model.gaussians.row_mut(Field::Normal, 1).copy_from_slice(&[0.5, 0.0, 0.0]);
        let before = Splats::of(&model);
        let axis = |s: &Splats| (s.rotations[1] * shortest_axis(s.log_scales[1])).as_vec3();
        assert!(axis(&before).dot(before.normals[1]).abs() < 0.95, "the control");
        let after = before.clone().flattened();
        assert!(axis(&after).dot(after.normals[1]).abs() > 1.0 - 1e-6);
        assert_eq!(after.rotations[0], before.rotations[0], "its normal is already its axis");
        assert_eq!(Splats { rotations: before.rotations.clone(), ..after }, before);
    }

    #[test]
    fn scale_is_positive_and_finite_for_any_logarithm() {
        let mut splats = Splats::of(&example());
        splats.log_scales[0] = [1e18, -1e18, 0.0];
        let scale = splats.scale(0);
        assert!(scale.iter().all(|s| s.is_finite() && *s > 0.0), "{scale:?}");
        assert_eq!(scale[2], 1.0);
    }
}
