//! The attribute row of a Gaussian, which blending sums, from its raw parameters; forward and backward (docs/MODEL.md,
//! sections 1 and 3).

use crate::cpu::project::{Geometry, GeometryGradient, Splat, normalise, normalise_backward, rotation};
use crate::cpu::surface::{MAX_COEFFICIENTS, Surface, SurfaceShader};
use crate::{NO_INDIRECT_BASIS, RasterCamera, RowLayout, sigmoid, sigmoid_derivative, softmax};
use relume_layout::channel::{self, Channels, IncidentLight, OutgoingRadiance, RowLight};
use relume_scene::light::{LightTables, sh_eval, sh_eval_with_gradient};
use relume_scene::{Field, Gaussians, IndirectForm, MAX_LIGHTS, NormalForm, ShadeAt, ShadingOptions};

/// Maximum number of radiance coefficients (degree 4).
const MAX_RADIANCE: usize = 25;

/// The input of the attribute kernels.
#[derive(Debug, Clone, Copy)]
pub struct AttributeSource<'a> {
    /// The Gaussians.
    pub gaussians: &'a Gaussians,
    /// Albedo prototypes.
    pub prototypes: &'a [[f32; 3]],
    /// Options of the forward model.
    pub options: &'a ShadingOptions,
    /// Measured indirect light per Gaussian: irradiance RGB, mean blocked radiance RGB. Empty: none.
    pub gathered: &'a [[f32; 6]],
    /// Measured share of each dominant light that arrives, per Gaussian. Empty: all of it.
    pub arriving: &'a [[f32; MAX_LIGHTS]],
    /// `E_j` of Eq. 20, for `IndirectForm::Learned`.
    pub indirect_basis: &'a [[f32; 3]; 16],
    /// Shader of the Gaussians, whose rows then carry [`OutgoingRadiance`]. `None`: rows carry [`IncidentLight`].
    pub light: Option<SurfaceShader<'a>>,
}

impl<'a> AttributeSource<'a> {
    /// The source without gathered, arriving and indirect light.
    pub fn new(gaussians: &'a Gaussians, prototypes: &'a [[f32; 3]], options: &'a ShadingOptions) -> Self {
        let indirect_basis = &NO_INDIRECT_BASIS;
        Self { gaussians, prototypes, options, gathered: &[], arriving: &[], indirect_basis, light: None }
    }

    /// The source with a light, for a model that is shaded at its Gaussians.
    #[must_use]
    pub fn under(self, light: SurfaceShader<'a>) -> Self {
        match self.options.shade_at {
            ShadeAt::Gaussian => self.shaded(light),
            ShadeAt::Pixel => self,
        }
    }

    /// The source with shading at the Gaussians, for every model.
    #[must_use]
    pub fn shaded(self, light: SurfaceShader<'a>) -> Self {
        Self { light: Some(light), ..self }
    }
}

impl AttributeSource<'_> {
    /// Kind of light in its rows.
    pub fn row_light(&self) -> RowLight {
        if self.light.is_some() { RowLight::Outgoing } else { RowLight::Incident }
    }

    /// Raw geometry of Gaussian `i`.
    #[inline]
    pub fn geometry(&self, i: usize) -> Geometry {
        let g = self.gaussians;
        Geometry {
            mean: g.get(Field::Mean, i),
            log_scale: g.get(Field::LogScale, i),
            quaternion: g.get(Field::Quaternion, i),
            opacity_logit: g.row(Field::OpacityLogit, i)[0],
            sampling_rate: g.row(Field::SamplingRate, i)[0],
        }
    }

    /// Fills `row` (`channels.stored()` floats, zero except for albedo, which is already written) for a visible splat.
    pub(super) fn write(&self, view: &RasterCamera, splat: &Splat, channels: Channels, row: &mut [f32]) {
        let i = splat.gaussian as usize;
        row[channel::COVERAGE] = 1.0;
        let geometry = self.geometry(i);
        let to_mean: [f32; 3] = std::array::from_fn(|k| geometry.mean[k] - view.centre[k]);
        row[channel::RADIANCE].copy_from_slice(&self.radiance(i, to_mean).colour);
        if channels == Channels::Colour {
            return;
        }
        let normal = self.normal(i, &geometry, to_mean);
        row[channel::NORMAL].copy_from_slice(&normal.unit);
        row[channel::PLANE] = (0..3).map(|k| normal.unit[k] * to_mean[k]).sum();
        if channels == Channels::Geometry {
            return;
        }
        row[channel::METAL] = sigmoid(self.gaussians.row(Field::MetalLogit, i)[0]);
        row[channel::ROUGH] = sigmoid(self.gaussians.row(Field::RoughLogit, i)[0]);
        let outgoing = self.light.map(|light| light.shade(&self.surface(i, row, to_mean)).outgoing());
        if let Some(outgoing) = &outgoing {
            row[OutgoingRadiance::TOTAL].copy_from_slice(&outgoing.total());
        }
        let Channels::Full(coefficients) = channels else { return };
        row[channel::DEPTH] = splat.depth;
        match &outgoing {
            Some(outgoing) => row[OutgoingRadiance::SPECULAR].copy_from_slice(&outgoing.specular),
            None => {
                let incident = self.incident(i);
                row[IncidentLight::GATHERED].copy_from_slice(&incident.gathered);
                row[IncidentLight::BLOCKED].copy_from_slice(&incident.blocked);
            }
        }
        row[channel::VISIBILITY..channel::VISIBILITY + coefficients]
            .copy_from_slice(&self.gaussians.row(Field::Visibility, i)[..coefficients]);
    }

    /// Light that Gaussian `i` receives from other surfaces.
    pub fn incident(&self, i: usize) -> IncidentLight {
        let mut out = IncidentLight::default();
        match self.options.indirect {
            IndirectForm::Off => {}
            IndirectForm::Learned => {
                for (w, e) in self.gaussians.row(Field::Indirect, i).iter().zip(self.indirect_basis) {
                    (0..3).for_each(|c| out.blocked[c] += w * e[c]);
                }
            }
            IndirectForm::Gathered => {
                if let Some([r, g, b, blocked @ ..]) = self.gathered.get(i) {
                    out = IncidentLight { gathered: [*r, *g, *b], blocked: *blocked };
                }
            }
        }
        out
    }

    /// Share of each dominant light that arrives at Gaussian `i`.
    pub fn arriving_at(&self, i: usize) -> [f32; MAX_LIGHTS] {
        self.arriving.get(i).copied().unwrap_or([1.0; MAX_LIGHTS])
    }

    /// Gaussian `i` as a surface seen along `to_mean` (mean minus camera centre), with normal and material from `row`.
    pub fn surface(&self, i: usize, row: &[f32], to_mean: [f32; 3]) -> Surface {
        let triple = |r: std::ops::Range<usize>| std::array::from_fn(|k| row[r.start + k]);
        let mut visibility = [0.0f32; MAX_COEFFICIENTS];
        visibility.iter_mut().zip(self.gaussians.row(Field::Visibility, i)).for_each(|(v, c)| *v = *c);
        let IncidentLight { gathered, blocked } = self.incident(i);
        Surface {
            normal: triple(channel::NORMAL),
            albedo: triple(channel::ALBEDO),
            metal: row[channel::METAL],
            rough: row[channel::ROUGH],
            sheen: self.gaussians.row(Field::Sheen, i)[0],
            gathered,
            blocked,
            arriving: self.arriving_at(i),
            visibility,
            view: normalise(to_mean).0.map(|v| -v),
        }
    }

    /// Radiance of Gaussian `i` under `light`, towards a camera that looks along unit direction `along`.
    pub fn outgoing(&self, i: usize, along: [f32; 3], light: &SurfaceShader<'_>) -> OutgoingRadiance {
        let mut row = [0.0f32; OutgoingRadiance::TOTAL.start];
        row[channel::NORMAL].copy_from_slice(&self.normal(i, &self.geometry(i), along).unit);
        row[channel::ALBEDO].copy_from_slice(&self.albedo(i).map(|a| a.clamp(0.0, 1.0)));
        row[channel::METAL] = sigmoid(self.gaussians.row(Field::MetalLogit, i)[0]);
        row[channel::ROUGH] = sigmoid(self.gaussians.row(Field::RoughLogit, i)[0]);
        light.shade(&self.surface(i, &row, along)).outgoing()
    }

    /// Chain rule through the light of a Gaussian with attributes `row`. Moves the gradient by the light in `by_row` to the
    /// channels that the light depends on, to `by_mean` (the gradient by the projected mean) and to the light tables.
    pub fn light_backward(
        &self,
        view: &RasterCamera,
        splat: &Splat,
        row: &[f32],
        (by_mean, by_row): (&mut [f32], &mut [f32]),
        by_tables: &mut LightTables,
    ) {
        let Some(light) = &self.light else { return };
        if by_row.len() < OutgoingRadiance::TOTAL.end
            || by_row[OutgoingRadiance::TOTAL].iter().all(|g| *g == 0.0)
        {
            return;
        }
        let i = splat.gaussian as usize;
        let mean: [f32; 3] = self.gaussians.get(Field::Mean, i);
        let to_mean = std::array::from_fn(|k| mean[k] - view.centre[k]);
        let surface = self.surface(i, row, to_mean);
        let g = std::array::from_fn(|c| by_row[OutgoingRadiance::TOTAL.start + c]);
        let trains_visibility = by_row.len() >= channel::VISIBILITY;
        let by = light.shade_backward(&surface, &light.shade(&surface), g, by_tables, trains_visibility);
        for c in 0..3 {
            by_row[channel::NORMAL.start + c] += by.normal[c];
            by_row[channel::ALBEDO.start + c] += by.albedo[c];
        }
        by_row[channel::METAL] += by.metal;
        by_row[channel::ROUGH] += by.rough;
        // The gradient by the outgoing radiance is consumed; its first channel now carries the gradient by sheen.
        by_row[OutgoingRadiance::SHEEN_GRADIENT] = by.sheen;
        if by_row.len() >= channel::VISIBILITY {
            (0..3).for_each(|c| by_row[IncidentLight::BLOCKED.start + c] += by.blocked[c]);
            by_row[channel::VISIBILITY..].iter_mut().zip(&by.visibility).for_each(|(o, g)| *o += g);
        }
        // The view direction depends on the projected mean alone.
        let (direction, length) = normalise(to_mean);
        let along: f32 = (0..3).map(|k| direction[k] * by.view[k]).sum();
        for (axis, by_mean) in by_mean.iter_mut().enumerate() {
            let across: f32 =
                (0..3).map(|k| (direction[k] * along - by.view[k]) * view.rotation[axis][k]).sum();
            *by_mean += across * splat.depth / (length * view.focal[axis]);
        }
    }

    /// Chain rule from a blended row's gradient (`by_row`, the differentiated channels) to the Gaussian's gradient row,
    /// except albedo. The gradient by geometry that the projection shares goes to `geometry_gradient`.
    pub fn write_backward(
        &self,
        view: &RasterCamera,
        splat: &Splat,
        by_row: &[f32],
        layout: &RowLayout,
        geometry_gradient: &mut GeometryGradient,
        out: &mut [f32],
    ) {
        let i = splat.gaussian as usize;
        let geometry = self.geometry(i);
        let to_mean: [f32; 3] = std::array::from_fn(|k| geometry.mean[k] - view.centre[k]);
        self.radiance_backward(i, to_mean, by_row, layout, geometry_gradient, out);
        if by_row.len() > channel::PLANE {
            self.normal_backward(i, &geometry, to_mean, by_row, layout, geometry_gradient, out);
        }
        if by_row.len() > channel::ROUGH {
            for (field, channel) in [(Field::MetalLogit, channel::METAL), (Field::RoughLogit, channel::ROUGH)]
            {
                out[layout.range(field)][0] +=
                    by_row[channel] * sigmoid_derivative(self.gaussians.row(field, i)[0]);
            }
        }
        if self.options.shade_at == ShadeAt::Gaussian && by_row.len() > OutgoingRadiance::SHEEN_GRADIENT {
            out[layout.range(Field::Sheen)][0] += by_row[OutgoingRadiance::SHEEN_GRADIENT];
        }
        if by_row.len() > channel::DEPTH {
            (0..3).for_each(|c| geometry_gradient.mean[c] += view.rotation[2][c] * by_row[channel::DEPTH]);
        }
        if by_row.len() >= channel::VISIBILITY {
            if self.options.indirect == IndirectForm::Learned {
                let g = &by_row[IncidentLight::BLOCKED];
                for (o, e) in out[layout.range(Field::Indirect)].iter_mut().zip(self.indirect_basis) {
                    *o += (0..3).map(|c| g[c] * e[c]).sum::<f32>();
                }
            }
            let visibility = &by_row[channel::VISIBILITY..];
            for (o, g) in out[layout.range(Field::Visibility)].iter_mut().zip(visibility) {
                *o += g;
            }
        }
    }

    /// Unclamped albedo of Gaussian `i` (Eq. 23).
    pub fn albedo(&self, i: usize) -> [f32; 3] {
        let residual: [f32; 3] = self.gaussians.get(Field::Residual, i);
        let scores = self.gaussians.row(Field::ProtoLogits, i);
        let mut buffer = [0.0f32; 256];
        let p = softmax(scores, &mut buffer[..scores.len().min(256)]);
        std::array::from_fn(|c| {
            residual[c] + p.iter().zip(self.prototypes).map(|(p, a)| p * a[c].clamp(0.0, 1.0)).sum::<f32>()
        })
    }

    /// Shading normal of Gaussian `i` as seen from the side of `outward`.
    pub fn normal_towards(&self, i: usize, outward: [f32; 3]) -> [f32; 3] {
        self.normal(i, &self.geometry(i), outward.map(|v| -v)).unit
    }

    fn normal(&self, i: usize, geometry: &Geometry, to_mean: [f32; 3]) -> Normal {
        let raw: [f32; 3] = self.gaussians.get(Field::Normal, i);
        let (axis, sign) = match self.options.normal {
            NormalForm::Free => (None, 1.0),
            NormalForm::ShortestAxis => {
                let s = geometry.log_scale;
                let axis = if s[0] <= s[1] && s[0] <= s[2] {
                    0
                } else if s[1] <= s[2] {
                    1
                } else {
                    2
                };
                let q = rotation(geometry.quaternion);
                let facing: f32 = (0..3).map(|r| q[r][axis] * to_mean[r]).sum();
                (Some((axis, q)), if facing > 0.0 { -1.0 } else { 1.0 })
            }
        };
        let sum = std::array::from_fn(|r| raw[r] + axis.map_or(0.0, |(a, q)| sign * q[r][a]));
        let (unit, length) = normalise(sum);
        Normal { unit, length, axis: axis.map(|(a, _)| (a, sign)) }
    }

    fn normal_backward(
        &self,
        i: usize,
        geometry: &Geometry,
        to_mean: [f32; 3],
        by_row: &[f32],
        layout: &RowLayout,
        geometry_gradient: &mut GeometryGradient,
        out: &mut [f32],
    ) {
        let normal = self.normal(i, geometry, to_mean);
        let by_plane = by_row[channel::PLANE];
        let by_unit = std::array::from_fn(|k| by_row[channel::NORMAL.start + k] + by_plane * to_mean[k]);
        (0..3).for_each(|k| geometry_gradient.mean[k] += by_plane * normal.unit[k]);
        let by_sum = normalise_backward(normal.unit, normal.length, by_unit);
        for (o, g) in out[layout.range(Field::Normal)].iter_mut().zip(by_sum) {
            *o += g;
        }
        if let Some((axis, sign)) = normal.axis {
            (0..3).for_each(|r| geometry_gradient.rotation[r][axis] += sign * by_sum[r]);
        }
    }

    fn radiance(&self, i: usize, to_mean: [f32; 3]) -> Radiance {
        let coefficients = self.gaussians.row(Field::Radiance, i);
        let (direction, length) = normalise(to_mean);
        let mut basis = [0.0f32; MAX_RADIANCE];
        sh_eval(self.gaussians.radiance_degree(), direction, &mut basis);
        let mut raw = [0.5f32; 3];
        for (s, y) in coefficients.chunks_exact(3).zip(&basis) {
            (0..3).for_each(|c| raw[c] += s[c] * y);
        }
        Radiance { colour: raw.map(|v| v.max(0.0)), is_positive: raw.map(|v| v > 0.0), direction, length }
    }

    fn radiance_backward(
        &self,
        i: usize,
        to_mean: [f32; 3],
        by_row: &[f32],
        layout: &RowLayout,
        geometry_gradient: &mut GeometryGradient,
        out: &mut [f32],
    ) {
        let by_colour = &by_row[channel::RADIANCE];
        if by_colour.iter().all(|g| *g == 0.0) {
            return;
        }
        let radiance = self.radiance(i, to_mean);
        let g: [f32; 3] = std::array::from_fn(|c| if radiance.is_positive[c] { by_colour[c] } else { 0.0 });
        let (mut basis, mut derivatives) = ([0.0f32; MAX_RADIANCE], [[0.0f32; 3]; MAX_RADIANCE]);
        sh_eval_with_gradient(
            self.gaussians.radiance_degree(),
            radiance.direction,
            &mut basis,
            &mut derivatives,
        );
        let coefficients = self.gaussians.row(Field::Radiance, i).chunks_exact(3);
        let gradients = out[layout.range(Field::Radiance)].chunks_exact_mut(3);
        let mut by_direction = [0.0f32; 3];
        for (((o, s), y), dy) in gradients.zip(coefficients).zip(&basis).zip(&derivatives) {
            let along: f32 = (0..3).map(|c| g[c] * s[c]).sum();
            (0..3).for_each(|c| o[c] += g[c] * y);
            (0..3).for_each(|k| by_direction[k] += along * dy[k]);
        }
        let by_mean = normalise_backward(radiance.direction, radiance.length, by_direction);
        (0..3).for_each(|k| geometry_gradient.mean[k] += by_mean[k]);
    }
}

struct Normal {
    unit: [f32; 3],
    length: f32,
    /// The column of the rotation that gave the normal, and its sign.
    axis: Option<(usize, f32)>,
}

struct Radiance {
    colour: [f32; 3],
    /// True where the clamp passes the gradient.
    is_positive: [bool; 3],
    direction: [f32; 3],
    length: f32,
}
