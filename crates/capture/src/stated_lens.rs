//! The intrinsics that a `transforms*.json` states, for all frames or for one.

use crate::CaptureError;
use crate::distortion::Distortion;
use crate::json_fields::Fields;
use crate::lens::Lens;

/// Keys of a matrix of intrinsics, 3x3 or 4x4.
const MATRICES: [&str; 4] = ["K", "intrinsic_matrix", "intrinsics", "camera_intrinsics"];

/// Intrinsics that both a file and a frame may state. Other keys (`sharpness`, `rotation`) are ignored.
#[derive(Debug, Clone, Default)]
pub(super) struct StatedLens {
    angle: [Option<f64>; 2],
    focal: [Option<f64>; 2],
    centre: [Option<f64>; 2],
    size: [Option<f64>; 2],
    /// `k1` to `k6`.
    k: [Option<f64>; 6],
    p: [Option<f64>; 2],
    /// `sx1` and `sy1`.
    s: [Option<f64>; 2],
    omega: Option<f64>,
    model: Option<String>,
    is_fisheye: Option<bool>,
    /// The key of a matrix of intrinsics that cannot be read. An error only if nothing else states the focal length.
    unread: Option<&'static str>,
}

impl StatedLens {
    /// Reads the intrinsics of a file or a frame.
    ///
    /// # Errors
    /// Names a field that is not a number.
    pub(super) fn read(fields: &Fields<'_>) -> Result<Self, CaptureError> {
        let number = |names: &[&str]| -> Result<Option<f64>, CaptureError> {
            names.iter().find(|name| fields.get(name).is_some()).map_or(Ok(None), |name| fields.number(name))
        };
        let mut focal = [number(&["fl_x", "fx"])?, number(&["fl_y", "fy"])?];
        let mut centre = [number(&["cx"])?, number(&["cy"])?];
        let mut unread = None;
        if focal == [None; 2] {
            match from_matrix(fields) {
                Some(Ok((f, c))) => (focal, centre) = (f.map(Some), c.map(Some)),
                Some(Err(name)) => unread = Some(name),
                None => {}
            }
        }
        let mut k = [None; 6];
        for (k, name) in k.iter_mut().zip(["k1", "k2", "k3", "k4", "k5", "k6"]) {
            *k = number(&[name])?;
        }
        Ok(Self {
            angle: [number(&["camera_angle_x"])?, number(&["camera_angle_y"])?],
            focal,
            centre,
            size: [number(&["w", "width"])?, number(&["h", "height"])?],
            k,
            p: [number(&["p1"])?, number(&["p2"])?],
            s: [number(&["sx1"])?, number(&["sy1"])?],
            omega: number(&["omega"])?,
            model: fields.text("camera_model")?.map(str::to_owned),
            is_fisheye: fields.flag("is_fisheye")?,
            unread,
        })
    }

    /// Takes each field from `self`. Fields that `self` does not have come from `shared`.
    pub(super) fn or(self, shared: &Self) -> Self {
        fn each<const N: usize>(own: [Option<f64>; N], shared: [Option<f64>; N]) -> [Option<f64>; N] {
            std::array::from_fn(|i| own[i].or(shared[i]))
        }
        Self {
            angle: each(self.angle, shared.angle),
            focal: each(self.focal, shared.focal),
            centre: each(self.centre, shared.centre),
            size: each(self.size, shared.size),
            k: each(self.k, shared.k),
            p: each(self.p, shared.p),
            s: each(self.s, shared.s),
            omega: self.omega.or(shared.omega),
            model: self.model.or_else(|| shared.model.clone()),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
            unread: self.unread.or(shared.unread),
        }
    }

    /// The lens.
    ///
    /// # Errors
    /// Names `camera_model` if the model is not supported, or the matrix that cannot be read.
    pub(super) fn lens(&self) -> Result<Lens, (&'static str, String)> {
        let has_focal = self.focal != [None; 2] || self.angle != [None; 2];
        if let Some(name) = self.unread.filter(|_| !has_focal) {
            return Err((
                name,
                "must be the matrix fx 0 cx; 0 fy cy; 0 0 1, or fx, fy, cx, cy, in pixels".to_owned(),
            ));
        }
        Ok(Lens {
            size: self.size[0].zip(self.size[1]),
            focal: self.focal,
            angle: self.angle,
            centre: self.centre,
            distortion: self.distortion()?.simplified(),
        })
    }

    fn distortion(&self) -> Result<Distortion, (&'static str, String)> {
        let value = |v: Option<f64>| v.unwrap_or(0.0);
        let k = self.k.map(value);
        let [k1, k2, k3, k4, ..] = k;
        let (p, first) = (self.p.map(value), [k1, k2, k3, k4]);
        let model = self.model.as_deref().map(str::to_ascii_uppercase);
        let is_fisheye = self.is_fisheye.unwrap_or(false);
        Ok(match model.as_deref() {
            None if is_fisheye => Distortion::Fisheye { k: first },
            Some("OPENCV_FISHEYE" | "RADIAL_FISHEYE" | "SIMPLE_RADIAL_FISHEYE") => {
                Distortion::Fisheye { k: first }
            }
            Some("THIN_PRISM_FISHEYE") => Distortion::ThinPrismFisheye { k: first, p, s: self.s.map(value) },
            Some("FULL_OPENCV") => Distortion::Rational { k, p },
            Some("FOV") => Distortion::FieldOfView { omega: value(self.omega) },
            None
            | Some("OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "PERSPECTIVE") => {
                Distortion::RadialTangential { k: first, p }
            }
            Some(_) => {
                let stated = self.model.as_deref().unwrap_or_default();
                let reason = format!(
                    "{stated:?} is not supported; undistort the photographs, or use OPENCV, FULL_OPENCV, OPENCV_FISHEYE or \
                     THIN_PRISM_FISHEYE"
                );
                return Err(("camera_model", reason));
            }
        })
    }
}

/// Focal lengths and principal point, pixels.
type FocalAndCentre = ([f64; 2], [f64; 2]);

/// Focal lengths and principal point from the matrix `fx 0 cx; 0 fy cy; 0 0 1`, its transpose, or the numbers `fx fy cx cy`; the key
/// if it has another form. `None` without such a key.
fn from_matrix(fields: &Fields<'_>) -> Option<Result<FocalAndCentre, &'static str>> {
    let name = MATRICES.into_iter().find(|name| fields.get(name).is_some())?;
    let rows = fields.rows(name).ok().flatten().unwrap_or_default();
    Some(match rows.iter().map(Vec::as_slice).collect::<Vec<_>>()[..] {
        [[fx, _, cx, ..], [_, fy, cy, ..], [a, b, one, ..], ..] if [*a, *b, *one] == [0.0, 0.0, 1.0] => {
            Ok(([*fx, *fy], [*cx, *cy]))
        }
        [[fx, _, a, ..], [_, fy, b, ..], [cx, cy, one, ..], ..] if [*a, *b, *one] == [0.0, 0.0, 1.0] => {
            Ok(([*fx, *fy], [*cx, *cy]))
        }
        [[fx, fy, cx, cy]] => Ok(([*fx, *fy], [*cx, *cy])),
        _ => Err(name),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn lens(value: Value) -> Result<Lens, String> {
        let fields = Fields::new("t.json", "", &value).unwrap();
        let stated = StatedLens::read(&fields).map_err(|error| error.to_string())?;
        stated.lens().map_err(|(field, reason)| format!("{field}: {reason}"))
    }

    #[test]
    fn matrices_of_intrinsics_are_read() {
        let k = json!([[90.0, 0, 48.0], [0, 91.0, 36.0], [0, 0, 1]]);
        let flat = json!([90.0, 0, 48.0, 0, 91.0, 36.0, 0, 0, 1]);
        let four = json!([[90.0, 0, 48.0, 0], [0, 91.0, 36.0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
        for (name, matrix) in [("K", k), ("intrinsics", flat), ("intrinsic_matrix", four)] {
            let lens = lens(json!({ name: matrix })).unwrap();
            assert_eq!((lens.focal, lens.centre), ([Some(90.0), Some(91.0)], [Some(48.0), Some(36.0)]));
        }
        let transposed = json!([[90.0, 0, 0], [0, 91.0, 0], [48.0, 36.0, 1]]);
        for (name, matrix) in [("K", transposed), ("intrinsics", json!([90.0, 91.0, 48.0, 36.0]))] {
            let lens = lens(json!({ name: matrix })).unwrap();
            assert_eq!((lens.focal, lens.centre), ([Some(90.0), Some(91.0)], [Some(48.0), Some(36.0)]));
        }
        let other = json!([[90.0, 0], [0, 91.0]]);
        assert!(lens(json!({"K": other})).unwrap_err().contains("K: must be the matrix"));
        let known = lens(json!({"K": other, "camera_angle_x": 0.8})).unwrap();
        assert_eq!(known.angle[0], Some(0.8), "the angle states the focal length");
    }

    #[test]
    fn camera_models_are_read_in_any_case_or_refused() {
        let of =
            |model: &str| lens(json!({"camera_model": model, "k1": 0.1, "k4": 0.2, "p1": 0.3, "sx1": 0.4}));
        let fisheye = Distortion::Fisheye { k: [0.1, 0.0, 0.0, 0.2] };
        assert_eq!(of("opencv_fisheye").unwrap().distortion, fisheye);
        let rational = Distortion::Rational { k: [0.1, 0.0, 0.0, 0.2, 0.0, 0.0], p: [0.3, 0.0] };
        assert_eq!(of("FULL_OPENCV").unwrap().distortion, rational);
        let prism = Distortion::ThinPrismFisheye { k: [0.1, 0.0, 0.0, 0.2], p: [0.3, 0.0], s: [0.4, 0.0] };
        assert_eq!(of("THIN_PRISM_FISHEYE").unwrap().distortion, prism);
        assert!(of("EQUIRECTANGULAR").unwrap_err().contains("camera_model: \"EQUIRECTANGULAR\""));
    }

    #[test]
    fn fields_of_a_frame_come_before_those_of_the_file() {
        let of = |value: &Value| StatedLens::read(&Fields::new("t.json", "", value).unwrap()).unwrap();
        let shared = of(&json!({"fl_x": 90, "cx": 48, "w": "96", "h": 72}));
        let lens = of(&json!({"fl_x": 80})).or(&shared).lens().unwrap();
        assert_eq!((lens.focal, lens.centre), ([Some(80.0), None], [Some(48.0), None]));
        assert_eq!(lens.size, Some((96.0, 72.0)));
        let lens = of(&json!({"K": [[70, 0, 8], [0, 71, 9], [0, 0, 1]]})).or(&shared).lens().unwrap();
        assert_eq!((lens.focal, lens.centre), ([Some(70.0), Some(71.0)], [Some(8.0), Some(9.0)]));
    }
}
