// Linear indices of dispatches that the host folds because of the limit of 65,535 workgroups per dimension.

// Index of this invocation, for workgroups of WG_SIZE x 1 x 1.
fn invocation_ix(gid: vec3u, n_wg: vec3u) -> u32 {
    return gid.y * n_wg.x * WG_SIZE + gid.x;
}

// Index of this workgroup.
fn workgroup_ix(wid: vec3u, n_wg: vec3u) -> u32 {
    return wid.y * n_wg.x + wid.x;
}
