// Counts the Gaussians with a label from this view: the label loss is the mean over them. A thread owns a Gaussian. Workgroup
// memory holds the workgroup's count, so that a workgroup needs one atomic addition in memory.
#import index
#import generated/objective

const WG_SIZE = 256u;

struct LabelCount {
    n: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

@group(0) @binding(0) var<uniform> uniforms: LabelCount;
// Per Gaussian: sum w That, sum w.
@group(0) @binding(1) var<storage, read> view_labels: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> label_count: array<atomic<u32>>;

var<workgroup> sh_count: atomic<u32>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if local_ix == 0u {
        atomicStore(&sh_count, 0u);
    }
    workgroupBarrier();
    if gaussian_ix < uniforms.n {
        if view_labels[gaussian_ix].y > MIN_LABEL_WEIGHT {
            atomicAdd(&sh_count, 1u);
        }
    }
    workgroupBarrier();
    if local_ix == 0u {
        atomicAdd(&label_count[0], atomicLoad(&sh_count));
    }
}
