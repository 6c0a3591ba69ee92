// Random numbers by counter: a hash of four words (PCG4D of Jarzynski and Olano 2020), so that no thread has a state.

fn hash4(words: vec4u) -> vec4u {
    var v = words * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> vec4u(16u);
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

// Two numbers in [0, 1), multiples of 2^-24.
fn uniform2(words: vec4u) -> vec2f {
    return vec2f(hash4(words).xy >> vec2u(8u)) * 5.9604645e-8;
}
