// Transmittance along single rays through a bounding volume hierarchy of the Gaussians: the port of
// crates/engine/src/cpu/rays.rs. The importer binds `nodes`, two vec4u per node, and `members`, four vec4f per occluder, and
// passes the rules.
//
// A node: low corner and first member (of a leaf) or right child; high corner and number of members, which is 0 for an inner
// node, whose left child is the next node. Corners are the bits of floats. A member: mean and opacity; three axes times
// standard deviations, the first with ln(255 opacity).
#import generated/occlusion
#import generated/projection
#import orthonormal

// Kept in step with `RayRules` of crates/engine/src/gpu/rays/tree.rs.
struct RayRules {
    // Smallest distance of an occluder along the ray, in its own standard deviations.
    clearance: f32,
    // Addend to that distance, world units.
    bias: f32,
    // Largest distance of an occluder, world units.
    reach: f32,
    n_nodes: u32,
}

// Smallest absolute component of a direction, so that its inverse is finite.
const MIN_SLOPE = 1e-20;

fn meets_box(low: vec3f, high: vec3f, origin: vec3f, inverse: vec3f) -> bool {
    let a = (low - origin) * inverse;
    let b = (high - origin) * inverse;
    let nearer = min(a, b);
    let farther = max(a, b);
    let enter = max(max(nearer.x, nearer.y), max(nearer.z, 0.0));
    return enter <= min(farther.x, min(farther.y, farther.z));
}

// Alpha of a member on a ray; `across` are two unit vectors that complete `d`.
fn alpha_on_ray(member_ix: u32, origin: vec3f, d: vec3f, across: mat2x3f, rules: RayRules) -> f32 {
    let place = members[4u * member_ix];
    let offset = place.xyz - origin;
    let depth = dot(offset, d);
    if !(depth >= rules.bias && depth <= rules.reach) {
        return 0.0;
    }
    let first = members[4u * member_ix + 1u];
    let axes = mat3x3f(first.xyz, members[4u * member_ix + 2u].xyz, members[4u * member_ix + 3u].xyz);
    if depth < rules.clearance * length(d * axes) + rules.bias {
        return 0.0;
    }
    let x = across[0] * axes;
    let y = across[1] * axes;
    let narrow = vec2f(dot(x, x), dot(y, y));
    let sum = narrow.x + narrow.y;
    // Without the widening a disc seen edge-on would have width 0.
    let widening = 1e-4 * sum + 1e-14;
    // All terms are positive: for needles `uu vv - uv^2` is the difference of two large numbers.
    let area = cross(x, y);
    let determinant = dot(area, area) + widening * sum + widening * widening;
    let variance = narrow + widening;
    if !(determinant > 0.0 && variance.x < MAX_OCCLUDER_VARIANCE && variance.y < MAX_OCCLUDER_VARIANCE) {
        return 0.0;
    }
    let p = offset * across;
    let root = sqrt(variance.y / determinant);
    let beside = root * p.x - dot(x, y) / determinant / root * p.y;
    let power = 0.5 * (beside * beside + p.y * p.y / variance.y);
    if !(power <= first.w) {
        return 0.0;
    }
    return min(place.w * exp(-power), ALPHA_MAX);
}

// Share of light, 0 to 1, that reaches `origin` from the unit direction `towards`.
fn ray_transmittance(origin: vec3f, towards: vec3f, rules: RayRules) -> f32 {
    let d = select(towards, select(vec3f(MIN_SLOPE), vec3f(-MIN_SLOPE), towards < vec3f(0.0)), abs(towards) < vec3f(MIN_SLOPE));
    let inverse = 1.0 / d;
    let across = orthonormal_pair(d);
    var left = 1.0;
    var stack: array<u32, TREE_DEPTH>;
    var height = min(rules.n_nodes, 1u);
    while height > 0u {
        height -= 1u;
        let at = stack[height];
        let low = nodes[2u * at];
        let high = nodes[2u * at + 1u];
        if !meets_box(bitcast<vec3f>(low.xyz), bitcast<vec3f>(high.xyz), origin, inverse) {
            continue;
        }
        if high.w == 0u {
            stack[height] = low.w;
            stack[height + 1u] = at + 1u;
            height += 2u;
            continue;
        }
        for (var member_ix = low.w; member_ix < low.w + high.w; member_ix++) {
            left *= 1.0 - alpha_on_ray(member_ix, origin, d, across, rules);
        }
        if left < MIN_TRANSMITTANCE {
            return 0.0;
        }
    }
    return left;
}
