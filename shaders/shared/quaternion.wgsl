// Rotations from quaternions (w x y z in xyzw of the vector) of any length; zero length is the identity.

// Unit vector and length: `v / max(|v|, 1e-12)`. Scaled first, so that squares of tiny components do not underflow.
fn normalised4(v: vec4f) -> vec4f {
    let a = abs(v);
    let most = max(max(a.x, a.y), max(a.z, a.w));
    let scale = max(most, 1e-30);
    let u = v / scale;
    let length = max(length(u) * scale, 1e-12);
    return v / length;
}

fn length4(v: vec4f) -> f32 {
    let a = abs(v);
    let scale = max(max(max(a.x, a.y), max(a.z, a.w)), 1e-30);
    return max(length(v / scale) * scale, 1e-12);
}

fn length3(v: vec3f) -> f32 {
    let a = abs(v);
    let scale = max(max(a.x, max(a.y, a.z)), 1e-30);
    return max(length(v / scale) * scale, 1e-12);
}

// `v / max(|v|, 1e-12)`.
fn normalised3(v: vec3f) -> vec3f {
    return v / length3(v);
}

// Gradient through `v / |v|`, given the unit vector and the length.
fn normalised3_backward(unit: vec3f, length: f32, g: vec3f) -> vec3f {
    return (g - dot(unit, g) * unit) / length;
}

// Q: `q[c]` is column c of the rotation matrix, the direction of axis c.
fn rotation_of(quaternion: vec4f) -> mat3x3f {
    if !(length4(quaternion) > 1e-12) {
        return mat3x3f(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    }
    let q = normalised4(quaternion);
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    return mat3x3f(
        vec3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3f(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3f(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}

// Gradient of the raw quaternion from that of the matrix (`g[c]` is the gradient of column c).
fn rotation_backward(quaternion: vec4f, g: mat3x3f) -> vec4f {
    let length = length4(quaternion);
    if !(length > 1e-12) {
        return vec4f(0.0);
    }
    let q = normalised4(quaternion);
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    // g[c][r] is the gradient of row r, column c.
    let by_unit = 2.0 * vec4f(
        x * (g[1][2] - g[2][1]) + y * (g[2][0] - g[0][2]) + z * (g[0][1] - g[1][0]),
        y * (g[1][0] + g[0][1]) + z * (g[2][0] + g[0][2]) + w * (g[1][2] - g[2][1]) - 2.0 * x * (g[1][1] + g[2][2]),
        x * (g[1][0] + g[0][1]) + z * (g[2][1] + g[1][2]) + w * (g[2][0] - g[0][2]) - 2.0 * y * (g[0][0] + g[2][2]),
        x * (g[2][0] + g[0][2]) + y * (g[2][1] + g[1][2]) + w * (g[0][1] - g[1][0]) - 2.0 * z * (g[0][0] + g[1][1]),
    );
    return (by_unit - dot(q, by_unit) * q) / length;
}
