//! Shading of each Gaussian on the device, forward and backward.

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::permutations::by_coefficients;
use crate::gpu::raster::attributes::Attributed;
use crate::gpu::raster::blend_backward::Differentiated;
use crate::gpu::raster::project::Projected;
use crate::gpu::shaders::Kernel;
use crate::gpu::shading::Shading;
use crate::gpu::{Bind, Buffer, Groups, Recorder, shaders, uniform};
use relume_layout::channel::Channels;

/// Operations per coefficient, forward: a multiply-add for four taps of three colours; about twice that backward.
const OPERATIONS_A_COEFFICIENT: u64 = 24;
/// Operations of the rest of a surface's shading.
const OPERATIONS_A_SURFACE: u64 = 600;

impl<'r> Attributed<'r> {
    /// Shades every Gaussian into its attribute row; the rows carry materials or all channels.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when the rows carry no material, or there is no kernel for the number of visibility
    /// coefficients.
    pub fn shade(&self, rec: &mut Recorder<'_>, shading: &Shading) -> Result<(), DeviceError> {
        let kernel = forward_kernel(shading.coefficients(), self.channels)?;
        shade_rows(&self.projected, rec, shading, kernel, vec![(&self.rows).into()])
    }

    /// Shades every Gaussian from its material row into a row of coverage and linear colour. Rows of Gaussians that reach no
    /// tile are undefined.
    ///
    /// # Errors
    /// As [`Attributed::shade`], or as [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn colours(self, rec: &mut Recorder<'_>, shading: &Shading) -> Result<Self, DeviceError> {
        use shaders::*;
        let all = [
            &LIGHT_COLOURS_1,
            &LIGHT_COLOURS_4,
            &LIGHT_COLOURS_9,
            &LIGHT_COLOURS_16,
            &LIGHT_COLOURS_25,
            &LIGHT_COLOURS_36,
            &LIGHT_COLOURS_49,
        ];
        if self.channels != Channels::Material {
            return Err(DeviceError::Misuse(format!("colours from rows of {:?}", self.channels)));
        }
        let kernel = by_coefficients(shading.coefficients(), all)?;
        let n = self.projected.gaussians();
        let raster = &mut *self.projected.raster;
        let colours = grow(&raster.gpu, "colours", &mut raster.colours, n)?;
        let rows = vec![(&self.rows).into(), (&colours).into()];
        shade_rows(&self.projected, rec, shading, kernel, rows)?;
        Ok(Self { projected: self.projected, channels: Channels::Colour, rows: colours })
    }
}

impl Differentiated<'_> {
    /// The backward pass of [`Attributed::shade`]: adds to the splat gradients and to `by_tables`, the gradient by the light
    /// tables, in their layout. All channels must have been differentiated.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when they were not, or as [`Attributed::shade`].
    pub fn shade_backward(
        &self,
        rec: &mut Recorder<'_>,
        shading: &Shading,
        by_tables: &Buffer<f32>,
    ) -> Result<(), DeviceError> {
        rec.stage("light backward");
        let (attributed, width) = (&self.blended.attributed, shading.coefficients());
        if self.groups != crate::gpu::groups(attributed.channels) {
            return Err(DeviceError::Misuse(format!("shading behind {} groups of gradients", self.groups)));
        }
        let kernel = backward_kernel(width, attributed.channels)?;
        let p = &attributed.projected;
        let (n, width) = (p.gaussians() as u64, width as u64);
        rec.work(n * 4 * (66 + width), n * 2 * (OPERATIONS_A_SURFACE + OPERATIONS_A_COEFFICIENT * width));
        let mut bindings = surface_bindings(p)?;
        bindings.extend([(&attributed.rows).into(), (&self.splat_gradients).into(), by_tables.into()]);
        shading.dispatch(rec, &p.camera, kernel, Groups::Linear(p.gaussians()), bindings);
        Ok(())
    }
}

fn shade_rows(
    p: &Projected<'_>,
    rec: &mut Recorder<'_>,
    shading: &Shading,
    kernel: &'static Kernel,
    rows: Vec<Bind<'_>>,
) -> Result<(), DeviceError> {
    rec.stage("light");
    let (n, width) = (p.gaussians() as u64, shading.coefficients() as u64);
    rec.work(n * 4 * (34 + width), n * (OPERATIONS_A_SURFACE + OPERATIONS_A_COEFFICIENT * width));
    let mut bindings = surface_bindings(p)?;
    bindings.extend(rows);
    shading.dispatch(rec, &p.camera, kernel, Groups::Linear(p.gaussians()), bindings);
    Ok(())
}

/// Bindings of a Gaussian's surface, except its row.
fn surface_bindings<'a>(p: &'a Projected<'_>) -> Result<Vec<Bind<'a>>, DeviceError> {
    if p.source.lacks_basis() {
        return Err(DeviceError::Misuse("shading: the indirect basis does not fit the model".to_owned()));
    }
    let or_nothing = |buffer: &'a Option<Buffer<f32>>| buffer.as_ref().unwrap_or(&p.raster.nothing).into();
    Ok(vec![
        uniform(&p.source.layout),
        (&p.source.params).into(),
        (&p.splats).into(),
        or_nothing(&p.source.gathered),
        or_nothing(&p.source.indirect_basis),
    ])
}

/// The error for rows without material, which no kernel can shade.
fn no_material(channels: Channels) -> DeviceError {
    DeviceError::Misuse(format!("shading of rows of {channels:?}"))
}

fn forward_kernel(coefficients: usize, channels: Channels) -> Result<&'static Kernel, DeviceError> {
    use shaders::*;
    let all = match channels {
        Channels::Full(_) => [
            &LIGHT_GAUSSIANS_ALL_1,
            &LIGHT_GAUSSIANS_ALL_4,
            &LIGHT_GAUSSIANS_ALL_9,
            &LIGHT_GAUSSIANS_ALL_16,
            &LIGHT_GAUSSIANS_ALL_25,
            &LIGHT_GAUSSIANS_ALL_36,
            &LIGHT_GAUSSIANS_ALL_49,
        ],
        Channels::Material => [
            &LIGHT_GAUSSIANS_1,
            &LIGHT_GAUSSIANS_4,
            &LIGHT_GAUSSIANS_9,
            &LIGHT_GAUSSIANS_16,
            &LIGHT_GAUSSIANS_25,
            &LIGHT_GAUSSIANS_36,
            &LIGHT_GAUSSIANS_49,
        ],
        Channels::Colour | Channels::Geometry => return Err(no_material(channels)),
    };
    by_coefficients(coefficients, all)
}

fn backward_kernel(coefficients: usize, channels: Channels) -> Result<&'static Kernel, DeviceError> {
    use shaders::*;
    let all = match channels {
        Channels::Full(_) => [
            &LIGHT_GAUSSIANS_ALL_BACKWARD_1,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_4,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_9,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_16,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_25,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_36,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_49,
        ],
        Channels::Material => [
            &LIGHT_GAUSSIANS_BACKWARD_1,
            &LIGHT_GAUSSIANS_BACKWARD_4,
            &LIGHT_GAUSSIANS_BACKWARD_9,
            &LIGHT_GAUSSIANS_BACKWARD_16,
            &LIGHT_GAUSSIANS_BACKWARD_25,
            &LIGHT_GAUSSIANS_BACKWARD_36,
            &LIGHT_GAUSSIANS_BACKWARD_49,
        ],
        Channels::Colour | Channels::Geometry => return Err(no_material(channels)),
    };
    by_coefficients(coefficients, all)
}
