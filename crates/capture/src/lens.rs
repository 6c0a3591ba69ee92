//! Intrinsics as capture files state them, and their conversion to the size of an image.

use crate::CaptureError;
use crate::distortion::Distortion;

/// Intrinsics; fields that a capture file may omit are optional.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Image size of the intrinsics, pixels; `None` means the stored image's own.
    pub size: Option<(f64, f64)>,
    /// Focal lengths, pixels.
    pub focal: [Option<f64>; 2],
    /// Full fields of view along x and y, radians; used where a focal length is absent.
    pub angle: [Option<f64>; 2],
    /// Principal point, pixels; `None` means the centre of the image.
    pub centre: [Option<f64>; 2],
    /// The lens's distortion.
    pub distortion: Distortion,
}

/// Focal lengths and principal point at an image's size, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Focal lengths along x and y.
    pub focal: (f64, f64),
    /// Principal point.
    pub centre: (f64, f64),
}

impl Lens {
    /// The size of the image for which the lens is stated, pixels; without it twice the principal point, which is close to the
    /// middle. `None` if neither is stated.
    pub(super) fn approximate_size(&self) -> Option<(f64, f64)> {
        let [cx, cy] = self.centre;
        self.size.or_else(|| Some((2.0 * cx?, 2.0 * cy?)))
    }

    /// The intrinsics scaled to an image of `(width, height)` pixels.
    ///
    /// # Errors
    /// Names `w,h`, `fl_x` or `camera_angle_x` when the size does not fit or no focal length follows.
    pub fn resolve(&self, file: &str, (width, height): (u32, u32)) -> Result<Intrinsics, CaptureError> {
        let bad = |field: &str, reason: String| CaptureError::at_field(file, field, reason);
        let image = (f64::from(width), f64::from(height));
        let stated = self.size.unwrap_or(image);
        if !(stated.0 >= 1.0 && stated.1 >= 1.0 && stated.0.is_finite() && stated.1.is_finite()) {
            return Err(bad("w,h", format!("{}x{} is not an image size", stated.0, stated.1)));
        }
        let scale = (image.0 / stated.0, image.1 / stated.1);
        // A reduced image has sides that were rounded to whole pixels.
        let rounding = (image.0 - stated.0 * scale.1).abs().min((image.1 - stated.1 * scale.0).abs());
        let is_rounded = width.min(height) >= 16 && rounding <= 1.0;
        if (scale.0 / scale.1 - 1.0).abs() > 0.02 && !is_rounded {
            let reason = format!("{}x{} does not fit an image of {width}x{height}", stated.0, stated.1);
            return Err(bad("w,h", reason));
        }
        let by_angle = |angle: Option<f64>, side: f64| angle.map(|a| 0.5 * side / (0.5 * a).tan());
        let fx = self.focal[0].or_else(|| by_angle(self.angle[0], stated.0));
        let fy = self.focal[1].or_else(|| by_angle(self.angle[1], stated.1));
        // Pixels are square unless two focal lengths are stated.
        let (Some(fx), Some(fy)) = (fx.or(fy), fy.or(fx)) else {
            return Err(bad("fl_x", "is missing, as is camera_angle_x: the focal length is unknown".into()));
        };
        let used = if self.focal == [None; 2] { self.angle } else { [None; 2] };
        if let Some(angle) = used.into_iter().flatten().find(|angle| *angle > std::f64::consts::PI) {
            let reason = format!("{angle} is not an angle in radians; divide degrees by 57.296");
            return Err(bad("camera_angle_x", reason));
        }
        if !(fx.is_finite() && fx > 0.0 && fy.is_finite() && fy > 0.0) {
            let field = if self.focal[0].is_some() { "fl_x,fl_y" } else { "camera_angle_x" };
            return Err(bad(field, format!("gives focal lengths {fx}, {fy}, which must be positive")));
        }
        let cx = self.centre[0].unwrap_or(0.5 * stated.0);
        let cy = self.centre[1].unwrap_or(0.5 * stated.1);
        if !(cx.is_finite() && cy.is_finite()) {
            return Err(bad("cx,cy", "must be finite".into()));
        }
        self.check_plausible((fx, fy), (cx, cy), stated).map_err(|(field, reason)| bad(field, reason))?;
        Ok(Intrinsics { focal: (fx * scale.0, fy * scale.1), centre: (cx * scale.0, cy * scale.1) })
    }
}

/// Fields of view that no pinhole photograph has, degrees.
const FIELD_OF_VIEW: std::ops::RangeInclusive<f64> = 2.0..=150.0;

impl Lens {
    /// Refuses numbers that no lens has, with the likely cause.
    fn check_plausible(
        &self,
        focal: (f64, f64),
        centre: (f64, f64),
        size: (f64, f64),
    ) -> Result<(), (&'static str, String)> {
        let is_small = |value: f64, side: f64| value.abs() <= 2.0 && side >= 16.0;
        let fov = |focal: f64, side: f64| (2.0 * (0.5 * side / focal).atan()).to_degrees();
        let widest = fov(focal.0, size.0).max(fov(focal.1, size.1));
        let is_fisheye = self.distortion.is_fisheye();
        if !is_fisheye && !FIELD_OF_VIEW.contains(&widest) {
            let field = if self.focal[0].is_some() { "fl_x,fl_y" } else { "camera_angle_x" };
            let cause = match (self.focal[0].is_some_and(|f| is_small(f, size.0)), widest < 2.0) {
                (true, _) => "; focal lengths must be in pixels, not relative to the size",
                (false, true) => "; the intrinsics may be those of a larger picture: state its w and h",
                (false, false) => "",
            };
            return Err((
                field,
                format!("gives a field of view of {widest:.1} degrees, not 2 to 150{cause}"),
            ));
        }
        let is_stated = self.centre[0].is_some() && self.centre[1].is_some();
        let is_near = |c: f64, side: f64| (-0.5 * side..=1.5 * side).contains(&c);
        if is_stated && is_small(centre.0, size.0) && is_small(centre.1, size.1) {
            return Err((
                "cx,cy",
                format!("({}, {}) must be in pixels, not relative to the size", centre.0, centre.1),
            ));
        }
        if !(is_near(centre.0, size.0) && is_near(centre.1, size.1)) {
            let (cx, cy) = centre;
            let reason = format!(
                "({cx}, {cy}) is far outside {} x {} pixels; the intrinsics may be those of a larger picture: state its w and h",
                size.0, size.1
            );
            return Err(("cx,cy", reason));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BARE: Lens = Lens {
        size: None,
        focal: [None; 2],
        angle: [None; 2],
        centre: [None; 2],
        distortion: Distortion::None,
    };

    #[test]
    fn field_of_view_gives_the_blender_focal_length() {
        let lens = Lens { angle: [Some(0.691_111_2), None], ..BARE };
        let i = lens.resolve("t.json", (800, 800)).unwrap();
        assert!((i.focal.0 - 1111.1).abs() < 0.1 && i.focal.0 == i.focal.1);
        assert_eq!(i.centre, (400.0, 400.0));
    }

    #[test]
    fn intrinsics_scale_only_to_images_of_the_same_aspect_ratio() {
        let lens = Lens {
            size: Some((1000.0, 500.0)),
            focal: [Some(800.0), Some(700.0)],
            centre: [Some(510.0), None],
            ..BARE
        };
        let i = lens.resolve("t.json", (500, 250)).unwrap();
        assert_eq!((i.focal, i.centre), ((400.0, 350.0), (255.0, 125.0)));
        let error = lens.resolve("t.json", (500, 500)).unwrap_err();
        assert_eq!(error.field(), Some("w,h"));
    }

    #[test]
    fn implausible_intrinsics_are_refused_by_field_with_the_cause() {
        let lens =
            |focal: f64, centre: Option<f64>| Lens { focal: [Some(focal); 2], centre: [centre; 2], ..BARE };
        let refused = |lens: Lens| lens.resolve("t.json", (96, 72)).unwrap_err().to_string();
        for (lens, field, cause) in [
            (lens(1.2, None), "fl_x,fl_y", "not relative to the size"),
            (lens(9.0, None), "fl_x,fl_y", "158.8 degrees"),
            (lens(9000.0, None), "fl_x,fl_y", "larger picture"),
            (lens(100.0, Some(0.5)), "cx,cy", "in pixels"),
            (lens(440.0, Some(192.0)), "cx,cy", "larger picture"),
            (Lens { angle: [Some(53.0), None], ..BARE }, "camera_angle_x", "radians"),
        ] {
            let text = refused(lens);
            assert!(text.contains(field) && text.contains(cause), "{lens:?}: {text}");
        }
        assert!(lens(100.0, Some(48.0)).resolve("t.json", (96, 72)).is_ok(), "the control");
        let fisheye = Lens { distortion: Distortion::Fisheye { k: [0.0; 4] }, ..lens(30.0, None) };
        assert!(fisheye.resolve("t.json", (200, 100)).is_ok(), "a fisheye lens may be wider");
    }

    #[test]
    fn missing_and_invalid_focal_lengths_are_refused_by_field() {
        assert_eq!(BARE.resolve("t.json", (8, 8)).unwrap_err().field(), Some("fl_x"));
        for angle in [0.0, -1.0, f64::NAN, 4.0] {
            let lens = Lens { angle: [Some(angle), None], ..BARE };
            assert_eq!(lens.resolve("t.json", (8, 8)).unwrap_err().field(), Some("camera_angle_x"));
        }
        let lens = Lens { focal: [Some(-5.0), Some(5.0)], ..BARE };
        assert_eq!(lens.resolve("t.json", (8, 8)).unwrap_err().field(), Some("fl_x,fl_y"));
    }
}
