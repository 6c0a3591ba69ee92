//! The columns of a table of splats, and the Gaussians of its rows.

use glam::Quat;

use crate::formats::ply_table::{PlyError, PlyTable, bad};
use crate::formats::splats::{MAX_SPLAT_SH_DEGREE, Y_0};
use relume_scene::{Field, Gaussians, sh_count};

/// Highest supported SH degree of a visibility field.
const MAX_VISIBILITY_DEGREE: usize = 8;
/// Least distance of a probability from 0 and 1 before its logit is taken.
const MIN_PROBABILITY: f32 = 1e-7;
/// Logit of full opacity: its sigmoid is 1 in f32.
const OPAQUE: f32 = 20.0;
/// Logarithm of the thickness of a splat without one, 1e-6 units of the file.
const FLAT: f32 = -13.815_511;
/// Greatest magnitude of a usable value.
pub(super) const MAX_MAGNITUDE: f64 = 1e12;
/// Greatest logarithm of a usable size: that of [`MAX_MAGNITUDE`] units of the file.
const MAX_LOG_SCALE: f64 = 27.631_021;
/// Least length of a quaternion with a direction.
const MIN_QUATERNION: f32 = 1e-12;

/// Columns of the values of a splat.
pub(super) struct SplatColumns {
    position: [usize; 3],
    /// The third is absent in files of 2D Gaussian Splatting, whose splats are discs in the plane of their first two axes
    /// (Huang et al. 2024, section 4.1).
    scale: [Option<usize>; 3],
    rotation: [usize; 4],
    opacity: usize,
    colour: ColourColumns,
    pub(super) normal: Option<[usize; 3]>,
    pub(super) material: Option<MaterialColumns>,
}

/// Columns of the colour.
enum ColourColumns {
    /// `(degree + 1)^2` RGB triples, one per SH coefficient.
    Harmonics { degree: usize, columns: Vec<[usize; 3]> },
    /// One display colour, and its value of full brightness.
    Rgb { columns: [usize; 3], white: [f64; 3] },
}

/// Columns of the materials of Relume.
pub(super) struct MaterialColumns {
    albedo: [usize; 3],
    metallic: usize,
    roughness: usize,
    pub(super) visibility: Vec<usize>,
    pub(super) visibility_degree: usize,
    sheen: Option<usize>,
    /// Pixels per unit of length.
    sampling_rate: Option<usize>,
}

impl SplatColumns {
    /// Finds the columns by their names.
    ///
    /// # Errors
    /// Names the first that is missing, or the kind of a file without splats.
    pub(super) fn of(table: &PlyTable) -> Result<Self, PlyError> {
        if ["opacity", "scale_0", "rot_0", "f_dc_0"].iter().all(|name| table.column(name).is_none()) {
            let names: Vec<&str> = table.names().take(12).collect();
            return bad(
                "element vertex",
                format!(
                    "is a point cloud or a mesh and not splats (its properties are {}): train a model from \
                     photographs, and give the points with their capture",
                    names.join(", ")
                ),
            );
        }
        let [scale_0, scale_1] = named(table, ["scale_0", "scale_1"])?;
        let rotation = named(table, ["rot_0", "rot_1", "rot_2", "rot_3"])?;
        Ok(Self {
            position: named(table, ["x", "y", "z"])?,
            scale: [Some(scale_0), Some(scale_1), table.column("scale_2")],
            rotation,
            opacity: named(table, ["opacity"])?[0],
            colour: ColourColumns::of(table)?,
            normal: named(table, ["nx", "ny", "nz"]).ok(),
            material: MaterialColumns::of(table)?,
        })
    }

    /// SH degree of the colour.
    pub(super) fn degree(&self) -> usize {
        match &self.colour {
            ColourColumns::Harmonics { degree, .. } => *degree,
            ColourColumns::Rgb { .. } => 0,
        }
    }

    /// Notes on the values that the import assumes for missing columns.
    pub(super) fn note(&self) -> Option<String> {
        let text = "the file has flat splats (2DGS, no scale_2); they have a thickness of 1e-6 units";
        self.scale[2].is_none().then(|| text.to_owned())
    }

    /// True if every value of a splat is usable. Opacity may be infinite, and log-scales minus infinity.
    pub(super) fn is_usable(&self, row: &[f64]) -> bool {
        let is_number = |column: &usize| row[*column].abs() <= MAX_MAGNITUDE;
        let is_scale = |column: &usize| row[*column] <= MAX_LOG_SCALE;
        let material = self.material.as_ref();
        self.position.iter().chain(&self.rotation).all(is_number)
            && self.scale.iter().flatten().all(is_scale)
            && !row[self.opacity].is_nan()
            && self.colour.all(&is_number)
            && material.is_none_or(|m| m.all().all(|column| is_number(&column)))
    }

    /// True if a splat has an opacity of 0.
    pub(super) fn is_invisible(&self, row: &[f64]) -> bool {
        row[self.opacity] < -MAX_MAGNITUDE
    }

    /// The rotation of a usable row, of any length; `None` if its quaternion is zero.
    pub(super) fn rotation(&self, row: &[f64]) -> Option<Quat> {
        let [w, x, y, z] = pick(row, self.rotation);
        Some(Quat::from_xyzw(x, y, z, w)).filter(|q| q.length() > MIN_QUATERNION)
    }

    /// Writes the shape and the colour of a usable row to Gaussian `i`.
    pub(super) fn read_splat(&self, row: &[f64], i: usize, out: &mut Gaussians) {
        out.row_mut(Field::Mean, i).copy_from_slice(&pick(row, self.position));
        let scale = self
            .scale
            .map(|column| column.map(|c| row[c]).filter(|s| *s >= -MAX_MAGNITUDE).map_or(FLAT, |s| s as f32));
        out.row_mut(Field::LogScale, i).copy_from_slice(&scale);
        let q = self.rotation(row).unwrap_or(Quat::IDENTITY);
        out.row_mut(Field::Quaternion, i).copy_from_slice(&[q.w, q.x, q.y, q.z]);
        let opacity = row[self.opacity];
        out.row_mut(Field::OpacityLogit, i)[0] =
            if opacity > MAX_MAGNITUDE { OPAQUE } else { opacity as f32 };
        self.colour.read(row, out.row_mut(Field::Radiance, i));
    }
}

impl ColourColumns {
    fn of(table: &PlyTable) -> Result<Self, PlyError> {
        let rgb = named(table, ["red", "green", "blue"]);
        if let (None, Ok(columns)) = (table.column("f_dc_0"), rgb) {
            return Ok(Self::Rgb { columns, white: columns.map(|c| table.white(c)) });
        }
        let rest = numbered(table, "f_rest");
        let bases = rest.len() / 3 + 1;
        let degree =
            (0..=MAX_SPLAT_SH_DEGREE).find(|l| sh_count(*l) == bases && rest.len().is_multiple_of(3));
        let Some(degree) = degree else {
            return bad(
                "property f_rest_*",
                format!("{} coefficients match no SH degree from 0 to 3 (0, 9, 24 or 45)", rest.len()),
            );
        };
        let first = named(table, ["f_dc_0", "f_dc_1", "f_dc_2"])?;
        let later = (1..bases).map(|j| std::array::from_fn(|c| rest[c * (bases - 1) + j - 1]));
        Ok(Self::Harmonics { degree, columns: std::iter::once(first).chain(later).collect() })
    }

    fn all(&self, is_true: &dyn Fn(&usize) -> bool) -> bool {
        match self {
            Self::Harmonics { columns, .. } => columns.as_flattened().iter().all(is_true),
            Self::Rgb { columns, .. } => columns.iter().all(is_true),
        }
    }

    /// Writes the coefficients of a row.
    fn read(&self, row: &[f64], out: &mut [f32]) {
        match self {
            Self::Harmonics { columns, .. } => {
                let values = columns.iter().flat_map(|columns| pick(row, *columns));
                out.iter_mut().zip(values).for_each(|(o, v)| *o = v);
            }
            Self::Rgb { columns, white } => {
                let shown = columns.iter().zip(white).map(|(c, white)| (row[*c] / white) as f32);
                out.iter_mut().zip(shown).for_each(|(o, v)| *o = (v - 0.5) / Y_0);
            }
        }
    }
}

impl MaterialColumns {
    /// `None` for a file without albedo.
    fn of(table: &PlyTable) -> Result<Option<Self>, PlyError> {
        let Ok(albedo) = named(table, ["albedo_0", "albedo_1", "albedo_2"]) else { return Ok(None) };
        let [metallic, roughness] = named(table, ["metallic", "roughness"])?;
        let visibility = numbered(table, "visibility");
        let sh_degree = (0..=MAX_VISIBILITY_DEGREE).find(|l| sh_count(*l) == visibility.len().max(1));
        let Some(visibility_degree) = sh_degree else {
            return bad(
                "property visibility_*",
                format!("{} coefficients match no SH degree", visibility.len()),
            );
        };
        let (sheen, sampling_rate) = (table.column("sheen"), table.column("sampling_rate"));
        Ok(Some(Self { albedo, metallic, roughness, visibility, visibility_degree, sheen, sampling_rate }))
    }

    fn all(&self) -> impl Iterator<Item = usize> + '_ {
        let single = [self.metallic, self.roughness].into_iter().chain(self.sheen).chain(self.sampling_rate);
        self.albedo.into_iter().chain(single).chain(self.visibility.iter().copied())
    }

    /// Writes the material of a usable row to Gaussian `i`.
    pub(super) fn read(&self, row: &[f64], i: usize, out: &mut Gaussians) {
        // The only prototype is black, so the residual is the albedo.
        out.row_mut(Field::Residual, i).copy_from_slice(&pick(row, self.albedo));
        out.row_mut(Field::MetalLogit, i)[0] = logit(row[self.metallic]);
        out.row_mut(Field::RoughLogit, i)[0] = logit(row[self.roughness]);
        let visibility = self.visibility.iter().map(|c| row[*c] as f32);
        out.row_mut(Field::Visibility, i).iter_mut().zip(visibility).for_each(|(o, v)| *o = v);
        out.row_mut(Field::Sheen, i)[0] = self.sheen.map_or(0.0, |c| row[c] as f32);
        out.row_mut(Field::SamplingRate, i)[0] = self.sampling_rate.map_or(0.0, |c| row[c] as f32);
    }
}

/// The values of some columns.
pub(super) fn pick<const N: usize>(row: &[f64], columns: [usize; N]) -> [f32; N] {
    columns.map(|c| row[c] as f32)
}

/// `logit(share)` for a share in [0, 1].
fn logit(share: f64) -> f32 {
    let share = (share as f32).clamp(MIN_PROBABILITY, 1.0 - MIN_PROBABILITY);
    (share / (1.0 - share)).ln()
}

fn named<const N: usize>(table: &PlyTable, names: [&str; N]) -> Result<[usize; N], PlyError> {
    let mut out = [0; N];
    for (o, name) in out.iter_mut().zip(names) {
        match table.column(name) {
            Some(column) => *o = column,
            None => {
                return bad(
                    format!("property {name}"),
                    "is missing: a splat has x, y, z, f_dc_0 to 2 (or red, green, blue), opacity, scale_0 to 2 and \
                     rot_0 to 3",
                );
            }
        }
    }
    Ok(out)
}

/// Columns `stem_0`, `stem_1`, ... up to the first that is missing.
fn numbered(table: &PlyTable, stem: &str) -> Vec<usize> {
    (0..).map_while(|k| table.column(&format!("{stem}_{k}"))).collect()
}
