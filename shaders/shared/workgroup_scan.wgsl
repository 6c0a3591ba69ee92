// Prefix sum over the 256 threads of a workgroup, without subgroup operations: eight doubling steps between two halves of one
// array, one barrier per step.

var<workgroup> sh_scan: array<u32, 512>;

struct WorkgroupScan {
    // Sum over the threads before this one.
    before: u32,
    // Sum over all threads.
    total: u32,
}

// All threads must call it; the caller puts a barrier between two calls.
fn scan_workgroup(local_ix: u32, value: u32) -> WorkgroupScan {
    sh_scan[local_ix] = value;
    workgroupBarrier();
    var half = 0u;
    for (var reach = 1u; reach < 256u; reach <<= 1u) {
        var sum = sh_scan[half + local_ix];
        if local_ix >= reach {
            sum += sh_scan[half + local_ix - reach];
        }
        half = 256u - half;
        sh_scan[half + local_ix] = sum;
        workgroupBarrier();
    }
    // After eight steps the result is in the half of the start.
    return WorkgroupScan(sh_scan[local_ix] - value, sh_scan[255]);
}
