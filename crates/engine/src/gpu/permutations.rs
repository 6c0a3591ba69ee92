//! Which permutation of a kernel serves a number of channels or of visibility coefficients.

use crate::DeviceError;
use crate::gpu::shaders::Kernel;
use relume_layout::channel::Channels;

/// The numbers of groups that kernels are compiled for, ascending.
const GROUPS: [usize; 9] = [1, 2, 4, 6, 8, 9, 12, 14, 18];

/// How many groups of four channels a pass over `channels` carries.
pub fn groups(channels: Channels) -> usize {
    channels.stored() / 4
}

/// The kernel for `groups` groups of channels; `kernels` are those of [`GROUPS`].
///
/// # Errors
/// [`DeviceError::Misuse`] when no kernel was compiled for them.
pub(super) fn by_groups(
    groups: usize,
    kernels: [&'static Kernel; 9],
) -> Result<&'static Kernel, DeviceError> {
    let found = GROUPS.iter().position(|g| *g == groups);
    found
        .map(|at| kernels[at])
        .ok_or_else(|| DeviceError::Misuse(format!("no kernel for {groups} groups of channels")))
}

/// The kernel for a visibility field of `coefficients`; `kernels` are those of orders 0 to 6.
///
/// # Errors
/// [`DeviceError::Misuse`] when no field has that many coefficients.
pub(super) fn by_coefficients(
    coefficients: usize,
    kernels: [&'static Kernel; 7],
) -> Result<&'static Kernel, DeviceError> {
    let sh_degree = (0..7).find(|sh_degree| (sh_degree + 1) * (sh_degree + 1) == coefficients);
    sh_degree
        .map(|sh_degree| kernels[sh_degree])
        .ok_or_else(|| DeviceError::Misuse(format!("no kernel for {coefficients} visibility coefficients")))
}
