// Sum over a workgroup of WG_SIZE (a power of two) threads, returned to every thread. All threads must call it.
var<workgroup> sh_reduce: array<vec4f, WG_SIZE>;

fn workgroup_sum(local_ix: u32, value: vec4f) -> vec4f {
    sh_reduce[local_ix] = value;
    workgroupBarrier();
    for (var width = WG_SIZE / 2u; width > 0u; width /= 2u) {
        if local_ix < width {
            sh_reduce[local_ix] += sh_reduce[local_ix + width];
        }
        workgroupBarrier();
    }
    let sum = sh_reduce[0];
    // The next call must not overwrite values that other threads still read.
    workgroupBarrier();
    return sum;
}
