// Two unit vectors that complete the unit `d` to an orthonormal basis (Duff et al. 2017), as in glam's `any_orthonormal_pair`.
fn orthonormal_pair(d: vec3f) -> mat2x3f {
    let sign = select(-1.0, 1.0, d.z >= 0.0);
    let a = -1.0 / (sign + d.z);
    let b = d.x * d.y * a;
    return mat2x3f(vec3f(1.0 + sign * d.x * d.x * a, sign * b, -sign * d.x), vec3f(b, sign + d.y * d.y * a, -d.y));
}
