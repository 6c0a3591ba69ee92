//! Shading of one surface (docs/MODEL.md, section 4), forward and backward. This file has the specular term, `lambert` the
//! diffuse one.

use crate::cpu::lambert::Lambert;
use crate::cpu::project::{normalise, normalise_backward};
use crate::cpu::surface::{MAX_COEFFICIENTS, Surface, SurfaceGradient, SurfaceShader, dot3};
use relume_layout::channel::OutgoingRadiance;
use relume_layout::constants::MIN_NOV;
use relume_scene::VisibilityForm;
use relume_scene::light::{
    BrdfLut, DIELECTRIC_F0, DiffuseShare, LOBE_DEGREES, LevelPosition, LightTables, LobeAttenuation,
    LutSample, Sheen, Taps, sh_eval, sh_eval_with_gradient,
};

/// A shaded surface with the values that its backward pass needs.
#[derive(Debug, Clone, Copy)]
pub struct Shaded {
    /// Diffuse radiance.
    pub diffuse: [f32; 3],
    /// Specular radiance.
    pub specular: [f32; 3],
    normal: [f32; 3],
    normal_length: f32,
    flipped: bool,
    nov: f32,
    nov_inside: bool,
    reflection: [f32; 3],
    reflection_length: f32,
    has_direct: bool,
    lambert: Lambert,
    sheen: Sheen,
    share: DiffuseShare<f32>,
    position: LevelPosition<f32>,
    level_taps: [Taps<f32>; 2],
    level_value: [[f32; 3]; 2],
    prefiltered: [f32; 3],
    visible: f32,
    visible_raw: f32,
    lut: LutSample<f32>,
}

impl Shaded {
    /// Radiance towards the camera.
    pub fn outgoing(&self) -> OutgoingRadiance {
        OutgoingRadiance { diffuse: self.diffuse, specular: self.specular }
    }
}

impl SurfaceShader<'_> {
    /// Radiance of the surface towards the camera.
    pub fn shade(&self, s: &Surface) -> Shaded {
        let (mut normal, normal_length) = normalise(s.normal);
        let facing = dot3(normal, s.view);
        let flipped = facing < 0.0;
        if flipped {
            normal = normal.map(|v| -v);
        }
        let nov_raw = facing.abs();
        let nov = nov_raw.clamp(MIN_NOV, 1.0);
        let bent = std::array::from_fn(|k| 2.0 * nov * normal[k] - s.view[k]);
        let (reflection, reflection_length) = normalise(bent);
        let direct = self.direct(s, normal, nov);
        let from_lights = direct.map_or([0.0; 3], |d| d.irradiance);
        let gathered = std::array::from_fn(|c| s.gathered[c] + from_lights[c]);
        let lambert = self.lambert(s, gathered, normal);
        let sheen = Sheen::new(s.sheen, nov);
        // Specular: split sum, visibility through the lobe.
        let position = LevelPosition::of(s.rough);
        let LevelPosition { level, fraction, .. } = position;
        let level_taps = [0, 1].map(|k| self.tables.specular_grids[level + k].lookup(reflection));
        let level_value = [0, 1].map(|k| {
            let values = &self.tables.specular[level + k];
            let t = &level_taps[k];
            let mut sum = [0.0f32; 3];
            for j in 0..4 {
                (0..3).for_each(|c| sum[c] += t.weight[j] * values[t.node[j]][c]);
            }
            sum
        });
        let prefiltered =
            std::array::from_fn(|c| level_value[0][c] * (1.0 - fraction) + level_value[1][c] * fraction);
        let (visible, visible_raw) = self.visible(s, reflection);
        let lut = BrdfLut::shared().sample(nov, s.rough);
        let share = lut.diffuse_share(self.options.conserves_energy);
        let mut specular = std::array::from_fn(|c| {
            let f0 = DIELECTRIC_F0 * (1.0 - s.metal) + s.albedo[c] * s.metal;
            let light = visible * prefiltered[c] + (1.0 - visible) * s.blocked[c];
            light * (f0 * lut.value[0] + lut.value[1])
        });
        if let Some(direct) = direct {
            (0..3).for_each(|c| specular[c] += direct.specular[c]);
        }
        Shaded {
            diffuse: lambert.radiance.map(|v| v * (sheen.gain * share.value)),
            sheen,
            share,
            specular,
            normal,
            normal_length,
            flipped,
            nov,
            nov_inside: nov_raw > MIN_NOV && nov_raw < 1.0,
            reflection,
            reflection_length,
            has_direct: direct.is_some(),
            lambert,
            position,
            level_taps,
            level_value,
            prefiltered,
            visible,
            visible_raw,
            lut,
        }
    }

    /// `h_l(r)` of the lobe form, or 1 for the article's `V(R)`; with derivatives.
    fn attenuation(&self, rough: f32) -> ([f32; LOBE_DEGREES], [f32; LOBE_DEGREES]) {
        if self.options.visibility == VisibilityForm::Sigmoid {
            return ([1.0; LOBE_DEGREES], [0.0; LOBE_DEGREES]);
        }
        let s = LobeAttenuation::shared().sample(rough);
        (s.value, s.by_roughness)
    }

    /// Visibility over the specular lobe, squashed and raw.
    pub(super) fn visible(&self, s: &Surface, reflection: [f32; 3]) -> (f32, f32) {
        if self.options.visibility == VisibilityForm::Off {
            return (1.0, 1.0);
        }
        let mut y = [0.0f32; MAX_COEFFICIENTS];
        sh_eval(self.sh_degree, reflection, &mut y);
        let (h, _) = self.attenuation(s.rough);
        let mut raw = 0.0;
        for (l, h) in h.iter().enumerate().take(self.sh_degree + 1) {
            let mut band = 0.0;
            for j in l * l..(l + 1) * (l + 1) {
                band += y[j] * s.visibility[j];
            }
            raw += h * band;
        }
        (self.squash(raw), raw)
    }

    /// Chain rule through [`Self::shade`]: `g` is the gradient by radiance. Table gradients are added to `tables`. The gradient by visibility
    /// is complete only if `trains_visibility`.
    pub fn shade_backward(
        &self,
        s: &Surface,
        f: &Shaded,
        g: [f32; 3],
        tables: &mut LightTables,
        trains_visibility: bool,
    ) -> SurfaceGradient {
        let mut out = SurfaceGradient::zero();
        let (sheen, share) = (&f.sheen, &f.share);
        let by_gain = dot3(g, f.lambert.radiance);
        let by_diffuse = g.map(|v| v * (sheen.gain * share.value));
        let mut by_normal =
            self.lambert_backward(s, &f.lambert, by_diffuse, tables, &mut out, trains_visibility);
        out.sheen = by_gain * share.value * sheen.by_sheen;
        out.rough = by_gain * sheen.gain * share.by_roughness;
        let (mut by_nov, by_reflection) = self.specular_backward(s, f, g, tables, &mut out);
        // R = normalize(2 nov n - v), nov = n . v.
        let by_bent = normalise_backward(f.reflection, f.reflection_length, by_reflection);
        by_nov = by_nov
            + 2.0 * dot3(by_bent, f.normal)
            + by_gain * (sheen.by_nov * share.value + sheen.gain * share.by_nov);
        for k in 0..3 {
            by_normal[k] += 2.0 * f.nov * by_bent[k];
            out.view[k] = -by_bent[k];
        }
        if f.has_direct {
            let by_irradiance = out.gathered;
            let by = self.direct_backward(s, (f.normal, f.nov), (by_irradiance, g), tables, &mut out);
            (0..3).for_each(|k| by_normal[k] += by.normal[k]);
            by_nov += by.nov;
        }
        for k in 0..3 {
            if f.nov_inside {
                by_normal[k] += by_nov * s.view[k];
                out.view[k] += by_nov * f.normal[k];
            }
        }
        if f.flipped {
            by_normal = by_normal.map(|v| -v);
        }
        let unit = if f.flipped { f.normal.map(|v| -v) } else { f.normal };
        out.normal = normalise_backward(unit, f.normal_length, by_normal);
        out
    }

    fn specular_backward(
        &self,
        s: &Surface,
        f: &Shaded,
        g: [f32; 3],
        tables: &mut LightTables,
        out: &mut SurfaceGradient,
    ) -> (f32, [f32; 3]) {
        let LevelPosition { level, fraction, by_roughness } = f.position;
        let mut by_reflection = [0.0f32; 3];
        let (mut by_nov, mut by_visible) = (0.0, 0.0);
        let mut by_level = [[0.0f32; 3]; 2];
        for c in 0..3 {
            let f0 = DIELECTRIC_F0 * (1.0 - s.metal) + s.albedo[c] * s.metal;
            let reflectance = f0 * f.lut.value[0] + f.lut.value[1];
            let light = f.visible * f.prefiltered[c] + (1.0 - f.visible) * s.blocked[c];
            let by_light = g[c] * reflectance;
            let by_reflectance = g[c] * light;
            let by_f0 = by_reflectance * f.lut.value[0];
            out.albedo[c] += by_f0 * s.metal;
            out.metal += by_f0 * (s.albedo[c] - DIELECTRIC_F0);
            by_nov += by_reflectance * (f0 * f.lut.by_nov[0] + f.lut.by_nov[1]);
            out.rough += by_reflectance * (f0 * f.lut.by_roughness[0] + f.lut.by_roughness[1]);
            by_visible += by_light * (f.prefiltered[c] - s.blocked[c]);
            out.blocked[c] = by_light * (1.0 - f.visible);
            let by_prefiltered = by_light * f.visible;
            by_level[0][c] = by_prefiltered * (1.0 - fraction);
            by_level[1][c] = by_prefiltered * fraction;
            out.rough += by_prefiltered * by_roughness * (f.level_value[1][c] - f.level_value[0][c]);
        }
        for k in 0..2 {
            let taps = &f.level_taps[k];
            for j in 0..4 {
                let value = self.tables.specular[level + k][taps.node[j]];
                let along = dot3(by_level[k], value);
                (0..3).for_each(|a| by_reflection[a] += along * taps.gradient[j][a]);
                let target = &mut tables.specular[level + k][taps.node[j]];
                (0..3).for_each(|c| target[c] += taps.weight[j] * by_level[k][c]);
            }
        }
        let by_raw = by_visible * self.squash_derivative(f.visible_raw, f.visible);
        if by_raw != 0.0 {
            let (mut y, mut dy) = ([0.0f32; MAX_COEFFICIENTS], [[0.0f32; 3]; MAX_COEFFICIENTS]);
            sh_eval_with_gradient(self.sh_degree, f.reflection, &mut y, &mut dy);
            let (h, dh) = self.attenuation(s.rough);
            for l in 0..=self.sh_degree {
                let mut band = 0.0;
                for j in l * l..(l + 1) * (l + 1) {
                    out.visibility[j] += by_raw * h[l] * y[j];
                    band += y[j] * s.visibility[j];
                    (0..3).for_each(|a| by_reflection[a] += by_raw * h[l] * s.visibility[j] * dy[j][a]);
                }
                out.rough += by_raw * dh[l] * band;
            }
        }
        (by_nov, by_reflection)
    }
}
