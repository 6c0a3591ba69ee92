//! The tree of occluders, in device memory.

use bytemuck::{Pod, Zeroable};

use crate::gpu::{Buffer, Gpu};
use crate::{DeviceError, RayTree};

/// `RayRules` of `shaders/shared/ray_tree.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct RayRules {
    clearance: f32,
    bias: f32,
    reach: f32,
    n_nodes: u32,
}

/// A [`RayTree`] in device memory.
#[derive(Debug, Clone)]
pub struct TreeBuffers {
    pub(super) rules: RayRules,
    pub(super) nodes: Buffer<[u32; 8]>,
    pub(super) members: Buffer<[f32; 16]>,
}

impl TreeBuffers {
    /// Uploads `tree`.
    ///
    /// # Errors
    /// When it does not fit.
    pub fn upload(gpu: &Gpu, tree: &RayTree) -> Result<Self, DeviceError> {
        let settings = tree.settings;
        let rules = RayRules {
            clearance: settings.clearance,
            bias: settings.bias,
            // Shader compilers may assume that no value is infinite.
            reach: settings.reach.min(f32::MAX),
            n_nodes: tree.nodes.len() as u32,
        };
        // A binding is never empty.
        let or_one = |none: bool| usize::from(none);
        let (nodes, members) = (&tree.nodes, &tree.members);
        Ok(Self {
            rules,
            nodes: gpu.upload("boxes", &[nodes, &vec![[0; 8]; or_one(nodes.is_empty())][..]].concat())?,
            members: gpu
                .upload("occluders", &[members, &vec![[0.0; 16]; or_one(members.is_empty())][..]].concat())?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::shaders::{self, assert_layout};

    #[test]
    fn ray_rules_are_laid_out_as_the_shaders_read_them() {
        assert_layout!(RayRules as "RayRules" in shaders::SHADOW_RAYS; clearance, bias, reach, n_nodes);
    }
}
