//! Selection of a kernel permutation by the number of channels or of visibility coefficients.

use crate::DeviceError;
use crate::gpu::shaders::Kernel;
use relume_layout::channel::Channels;

/// Numbers of groups for which kernels are compiled, ascending.
const GROUPS: [usize; 9] = [1, 2, 4, 6, 8, 9, 12, 14, 18];

/// Number of groups of four channels in a pass over `channels`.
pub fn groups(channels: Channels) -> usize {
    channels.stored() / 4
}

/// The kernel for `groups` groups of channels; `kernels` are in the order of [`GROUPS`].
///
/// # Errors
/// [`DeviceError::Misuse`] when no kernel is compiled for this number.
pub(super) fn by_groups(
    groups: usize,
    kernels: [&'static Kernel; 9],
) -> Result<&'static Kernel, DeviceError> {
    let found = GROUPS.iter().position(|g| *g == groups);
    found
        .map(|at| kernels[at])
        .ok_or_else(|| DeviceError::Misuse(format!("no kernel for {groups} groups of channels")))
}

/// The kernel for a visibility field with `coefficients` coefficients; `kernels` are those of degrees 0 to 6.
///
/// # Errors
/// [`DeviceError::Misuse`] when no degree has this number of coefficients.
pub(super) fn by_coefficients(
    coefficients: usize,
    kernels: [&'static Kernel; 7],
) -> Result<&'static Kernel, DeviceError> {
    let sh_degree = (0..7).find(|sh_degree| (sh_degree + 1) * (sh_degree + 1) == coefficients);
    sh_degree
        .map(|sh_degree| kernels[sh_degree])
        .ok_or_else(|| DeviceError::Misuse(format!("no kernel for {coefficients} visibility coefficients")))
}
