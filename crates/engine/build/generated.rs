//! WGSL constants and layouts from the Rust definitions of `relume-layout`, for `#import generated/NAME`. The build script
//! also writes all pieces to one WGSL file in its output folder, for reading.

use std::fmt::Write as _;
use std::ops::Range;

use relume_layout::channel::{self, Channels, GROUP, IncidentLight, OutgoingRadiance};
use relume_layout::kernel_constants::{self, GRADIENT_HEADER, LossSlot};
use relume_layout::{Field, FieldWidth, constants, light};

/// `const NAME = value;` for each constant of a module.
macro_rules! list {
    ($module:ident: $($name:ident),+) => {
        [$(constant(stringify!($name), $module::$name)),+].concat()
    };
}

/// Names of all pieces.
pub const PIECES: [&str; 11] = [
    "channels",
    "density",
    "kernels",
    "level",
    "light",
    "objective",
    "occlusion",
    "parameters",
    "projection",
    "slots",
    "surface_point",
];

/// All pieces, one after another.
pub fn all() -> String {
    PIECES
        .iter()
        .flat_map(|name| [format!("// generated/{name}\n"), piece(name).unwrap_or_default()])
        .collect()
}

/// The text of a piece; `None` for an unknown name.
pub fn piece(name: &str) -> Option<String> {
    Some(match name {
        "channels" => channels(),
        "density" => list![constants: HALF_SCALE_ALONG, HALF_SCALE_ACROSS, HALF_OPACITY_EXPONENT],
        "kernels" => list![kernel_constants: SCAN_BLOCK, SORT_BLOCK],
        "level" => level(),
        "light" => light(),
        "objective" => objective(),
        "occlusion" => {
            list![constants: NO_HIT, MIN_TRANSMITTANCE, MAX_OCCLUDER_VARIANCE, MIN_BLOCKED_SHARE, SKY_SHADOW_LEVEL, TREE_DEPTH]
        }
        "parameters" => parameters(),
        "projection" => {
            list![constants: TILE, NEAR, FAR, MAX_PIXEL_DISTANCE, MAX_SCREEN_VARIANCE, MAX_ENLARGEMENT, ENLARGED_LOW_PASS, MIN_DETERMINANT,
            LOG_SCALE_LIMIT, ALPHA_MIN, ALPHA_MAX]
        }
        "slots" => slots(),
        "surface_point" => surface_point(),
        _ => return None,
    })
}

/// A value as a WGSL literal.
trait Literal {
    fn literal(&self) -> String;
}

impl Literal for u32 {
    fn literal(&self) -> String {
        format!("{self}u")
    }
}

impl Literal for usize {
    fn literal(&self) -> String {
        format!("{self}u")
    }
}

impl Literal for f32 {
    /// Enough digits to identify the value, with its type, so that expressions of it round as on the host.
    fn literal(&self) -> String {
        format!("{self:?}f")
    }
}

impl<const N: usize> Literal for [f32; N] {
    fn literal(&self) -> String {
        format!("array<f32, {N}>({})", self.map(|v| v.literal()).join(", "))
    }
}

fn constant(name: &str, value: impl Literal) -> String {
    format!("const {name} = {};\n", value.literal())
}

/// Groups of four channels and their content.
fn channels() -> String {
    let mut out = list![kernel_constants: GRADIENT_HEADER];
    out += &constant("HEADER_GROUPS", GRADIENT_HEADER / GROUP);
    out += "// Groups of a row, by the channels it carries.\n";
    for (name, channels) in [
        ("COLOUR", Channels::Colour),
        ("GEOMETRY", Channels::Geometry),
        ("MATERIAL", Channels::Material),
        ("FULL", Channels::Full(1)),
    ] {
        out += &constant(&format!("GROUPS_{name}"), channels.stored() / GROUP);
    }
    out += "// The group of four that holds each channel.\n";
    for (name, first) in [
        ("COVERAGE", channel::COVERAGE),
        ("NORMAL", channel::NORMAL.start),
        ("ALBEDO", channel::ALBEDO.start),
        ("ROUGH", channel::ROUGH),
        ("DEPTH", channel::DEPTH),
        ("VISIBILITY", channel::VISIBILITY),
    ] {
        out += &constant(&format!("{name}_GROUP"), first / GROUP);
    }
    out += &constant("FIRST_VISIBILITY", channel::VISIBILITY);
    let one = |channel: usize| channel..channel + 1;
    for (name, channels) in [
        ("coverage", one(channel::COVERAGE)),
        ("radiance", channel::RADIANCE),
        ("normal", channel::NORMAL),
        ("plane", one(channel::PLANE)),
        ("albedo", channel::ALBEDO),
        ("metal", one(channel::METAL)),
        ("rough", one(channel::ROUGH)),
        ("depth", one(channel::DEPTH)),
        ("outgoing", OutgoingRadiance::TOTAL),
        ("specular", OutgoingRadiance::SPECULAR),
        ("gathered", IncidentLight::GATHERED),
        ("blocked", IncidentLight::BLOCKED),
        ("by_sheen", one(OutgoingRadiance::SHEEN_GRADIENT)),
    ] {
        out += &accessor(name, channels);
    }
    out
}

/// A WGSL function that returns `channels` of their group.
fn accessor(name: &str, channels: Range<usize>) -> String {
    let first = channels.start % GROUP;
    let swizzle = &"xyzw"[first..first + channels.len()];
    let kind = if channels.len() == 1 { "f32" } else { "vec3f" };
    format!("fn channel_{name}(group: vec4f) -> {kind} {{ return group.{swizzle}; }}\n")
}

/// The assumed level of an unknown light.
fn level() -> String {
    let [red, green, blue] = light::LUMINANCE;
    format!("const LUMINANCE = vec3f({red:?}, {green:?}, {blue:?});\n") + &list![light: UPWARD_LUMINANCE]
}

fn light() -> String {
    let mut out = list![light: UNOCCLUDED_SH0, DIELECTRIC_F0, MAX_SHEEN, SPECULAR_LEVELS, LUT_SIZE, LOBE_DEGREES,
        LOBE_ROUGHNESSES];
    out += &list![constants: MIN_COVERAGE, MIN_NOV];
    out += &list![relume_layout: MAX_LIGHTS];
    out += &constant("N_LEVELS", light::SPECULAR_LEVELS.len());
    out += "// lambda_l / pi of the clamped cosine.\n";
    let factors: [f32; light::MAX_FIELD_SH_DEGREE + 1] =
        std::array::from_fn(|l| light::nrsh_factor(l) as f32);
    out += &constant("NRSH_FACTORS", factors);
    out += "// K_lm with the sqrt(2) of m > 0, at l (l + 1) / 2 + m.\n";
    const NORMS: usize = (light::MAX_FIELD_SH_DEGREE + 1) * (light::MAX_FIELD_SH_DEGREE + 2) / 2;
    let mut norms = [0.0; NORMS];
    for l in 0..=light::MAX_FIELD_SH_DEGREE {
        (0..=l).for_each(|m| norms[l * (l + 1) / 2 + m] = light::sh_normalisation(l, m) as f32);
    }
    out + &constant("SH_NORM", norms)
}

fn objective() -> String {
    let out = list![constants: ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON, AGGREGATION_EPSILON, MIN_LABEL_WEIGHT,
        LABEL_MARGIN, SIGMOID_MARGIN, TRUSTED_COVERAGE, MAX_DEPTH_STEP, SSIM_TAPS, SSIM_C1, SSIM_C2];
    out + &constant("SSIM_WINDOW", constants::ssim_window())
}

/// Fields in storage order, and the offset of each in the planar parameter buffer.
fn parameters() -> String {
    let mut out = String::new();
    for field in Field::ALL {
        let name = format!("FIELD_{}", field.kernel_name().to_uppercase());
        out += &constant(&name, field as usize);
    }
    out += "// Radiance coefficients beyond the first, which have a step size of their own.\n";
    out += &constant("FIELD_RADIANCE_REST", Field::COUNT);
    out += &constant("N_PARAMETER_FIELDS", Field::COUNT);
    out += &constant("N_FIELDS", Field::COUNT + 1);
    out += &list![kernel_constants: NORMAL_FREE, NORMAL_SHORTEST_AXIS, INDIRECT_OFF, INDIRECT_LEARNED,
        INDIRECT_GATHERED, VISIBILITY_OFF, VISIBILITY_LINEAR, VISIBILITY_SIGMOID, DIFFUSE_AMBIENT_OCCLUSION,
        DIFFUSE_DIRECTIONAL, SHADE_AT_PIXEL, SHADE_AT_GAUSSIAN];
    let counts = ["n", "n_scores", "n_visibility", "n_radiance"];
    let forms = ["normal_form", "indirect_form", "visibility_form", "diffuse_form", "shade_at"];
    let mut members: Vec<&str> = counts.to_vec();
    members.extend(Field::ALL.map(Field::kernel_name));
    members.extend(forms);
    let n_pads = members.len().next_multiple_of(4) - members.len();
    members.extend(&["pad_0", "pad_1", "pad_2"][..n_pads]);
    out += "// Element k of field F of Gaussian i is at `layout.F + i * width of F + k`; `n_visibility` and `n_radiance` count SH\n\
            // coefficients, not floats.\nstruct Layout {\n";
    for member in members {
        let _ = writeln!(out, "    {member}: u32,");
    }
    out += "}\n";
    out += &field_function("start", |field| format!("model.{}", field.kernel_name()));
    out + &field_function("width", |field| match field.width() {
        FieldWidth::Fixed(floats) => floats.literal(),
        FieldWidth::Prototypes => "model.n_scores".to_owned(),
        FieldWidth::Visibility => "model.n_visibility".to_owned(),
        FieldWidth::Radiance => "3u * model.n_radiance".to_owned(),
    })
}

/// A WGSL function of a field's number.
fn field_function(name: &str, value: impl Fn(Field) -> String) -> String {
    let mut out = format!("fn field_{name}(model: Layout, field: u32) -> u32 {{\n    switch field {{\n");
    for field in Field::ALL {
        let _ = writeln!(out, "        case {}u: {{ return {}; }}", field as usize, value(field));
    }
    out + "        default: { return 0u; }\n    }\n}\n"
}

/// Slots of the losses buffer.
fn slots() -> String {
    let mut out = String::new();
    for slot in LossSlot::ALL {
        out += &constant(&format!("LOSS{}", screaming(&format!("{slot:?}"))), slot as usize);
    }
    out
}

/// Constants of a pixel's surface point and of the start points of rays towards small lights.
fn surface_point() -> String {
    let places = constants::SHADOW_SAMPLE_OFFSETS;
    let mut out = list![constants: MAX_PLANE_DEPTH_ERROR, MAX_MEAN_DEPTH_ERROR, LIFT];
    out += &constant("N_SHADOW_SAMPLES", places.len());
    let floats: [f32; 2 * constants::SHADOW_SAMPLE_OFFSETS.len()] =
        std::array::from_fn(|i| places[i / 2][i % 2]);
    out += "// x and y, one after the other.\n";
    out + &constant("SHADOW_SAMPLE_OFFSETS", floats)
}

/// `PhysicalL1` as `_PHYSICAL_L1`.
fn screaming(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if c.is_uppercase() {
            out.push('_');
        }
        out.extend(c.to_uppercase());
    }
    out
}
