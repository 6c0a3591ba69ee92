//! World coordinates of a training by nerfstudio.

use glam::{DMat4, DVec4};
use serde::{Deserialize, Serialize};

/// nerfstudio's transformation of the capture's world before training, `x' = scale * transform * x`, as in
/// its file `dataparser_transforms.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NerfstudioWorld {
    /// Rows of a rigid transformation.
    pub transform: [[f64; 4]; 3],
    /// Scale factor, more than 0.
    pub scale: f64,
}

impl NerfstudioWorld {
    /// # Errors
    /// The reason if the transformation is not invertible.
    pub fn check(&self) -> Result<(), String> {
        let invertible = self.matrix().determinant().abs() > 1e-9;
        match invertible && self.scale.is_finite() && self.scale > 0.0 {
            true => Ok(()),
            false => Err("transform must be invertible and scale a finite number above 0".to_owned()),
        }
    }

    fn matrix(&self) -> DMat4 {
        let [x, y, z] = self.transform.map(DVec4::from_array);
        DMat4::from_cols(x, y, z, DVec4::W).transpose()
    }

    /// Converts a camera-to-world matrix from nerfstudio's world to the world of the capture.
    pub fn to_capture_world(&self, mut pose: DMat4) -> DMat4 {
        pose.w_axis = (pose.w_axis.truncate() / self.scale).extend(1.0);
        self.matrix().inverse() * pose
    }
}
