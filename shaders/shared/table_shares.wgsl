// Adds the members of a workgroup of WG_SIZE threads, pixels or Gaussians, to the gradient of the light tables.
//
// A member adds to four nodes of the diffuse table, 12 x S sums, or to four nodes of a specular level, and members share
// nodes. So the members are sorted by cell in workgroup memory (cell, weights, gradient and position per member: 10 KiB). Each
// thread then owns one (tap, colour, four coefficients), iterates over the sorted members, and adds to memory only where the
// cell changes. Visibility does not fit in workgroup memory as well; it is read again from its source, which is in the cache.
//
// The importer binds `by_tables: array<accumulator>` and defines `member_visibility(local_ix, quad) -> vec4f`.

const NO_CELL = 0xffffffffu;
// A cell has its level in the upper 8 bits and its first node in the lower ones; the grid of normals counts as a level.
const DIFFUSE_LEVEL = 7u;
const NODE_BITS = 24u;

var<workgroup> sh_cell: array<u32, WG_SIZE>;
var<workgroup> sh_weight: array<vec4f, WG_SIZE>;
// Gradient by the looked-up value; w is the member's own number.
var<workgroup> sh_by: array<vec4f, WG_SIZE>;
var<workgroup> sh_member_of_place: array<u32, WG_SIZE>;

// Contribution of a member to the diffuse table and to the two specular levels.
struct Shares {
    // NO_CELL where the member adds nothing.
    cell: vec3u,
    // Bilinear weights of the cell's nodes.
    weight: array<vec4f, 3>,
    // Gradient by the looked-up values, rgb.
    by: array<vec3f, 3>,
    // 1 / coverage.
    inverse: f32,
    // Gradient by the irradiance of the dominant lights; the importer adds it.
    lights: array<vec3f, MAX_LIGHTS>,
}

fn cell_of(level: u32, taps: Taps, by: vec3f) -> u32 {
    return select(NO_CELL, (level << NODE_BITS) | taps.node.x, any(by != vec3f(0.0)));
}

// First float of the row of one colour of one node of a cell.
fn row_of(cell: u32, tap: u32, colour: u32) -> u32 {
    let level = cell >> NODE_BITS;
    let is_diffuse = level == DIFFUSE_LEVEL;
    let edge = select(specular_nodes(level), tables.diffuse_n, is_diffuse);
    let node = (cell & ((1u << NODE_BITS) - 1u)) + (tap & 1u) + (tap >> 1u) * edge;
    let row = 3u * node + colour;
    return select(specular_start(level) + row, row * tables.coefficients, is_diffuse);
}

fn add_quad(at: u32, value: vec4f) {
    for (var k = 0u; k < 4u; k++) {
        if value[k] != 0.0 {
            accumulate!(by_tables[at + k], value[k]);
        }
    }
}

// Factor of a member's share: its visibility, or one number for it.
fn shared_quad(is_diffuse: bool, member_ix: u32, quad: u32) -> vec4f {
    if !is_diffuse || is_scalar() {
        return vec4f(select(1.0, UNOCCLUDED_SH0, is_diffuse), 0.0, 0.0, 0.0);
    }
    return member_visibility(member_ix, quad);
}

fn add_sorted(is_diffuse: bool, local_ix: u32) {
    let n_quads = select(1u, N_QUADS, is_diffuse && !is_scalar());
    // Threads that share one output each process a strip of the members.
    let n_outputs = 12u * n_quads;
    let n_strips = WG_SIZE / n_outputs;
    let strip = local_ix / n_outputs;
    if strip >= n_strips {
        return;
    }
    let output = local_ix % n_outputs;
    let tap = output / (3u * n_quads);
    let colour = (output / n_quads) % 3u;
    let quad = output % n_quads;
    let end = (strip + 1u) * WG_SIZE / n_strips;
    var cell = NO_CELL;
    var sum = vec4f(0.0);
    for (var place = strip * WG_SIZE / n_strips; place <= end; place++) {
        // One step beyond the end adds the rest.
        let member_ix = sh_member_of_place[min(place, WG_SIZE - 1u)];
        let next = select(NO_CELL, sh_cell[member_ix], place < end);
        if next != cell {
            if cell != NO_CELL {
                add_quad(row_of(cell, tap, colour) + 4u * quad, sum);
            }
            cell = next;
            sum = vec4f(0.0);
        }
        // Members that add nothing come last.
        if next == NO_CELL {
            break;
        }
        let value = shared_quad(is_diffuse, member_ix, quad);
        sum += (sh_weight[member_ix][tap] * sh_by[member_ix][colour]) * value;
    }
}

// Adds the shares of all members of the workgroup to one table, the diffuse one or a specular level; every thread must call
// it.
fn add_shares(is_diffuse: bool, local_ix: u32, cell: u32, weight: vec4f, by: vec4f) {
    sh_cell[local_ix] = cell;
    sh_weight[local_ix] = weight;
    sh_by[local_ix] = by;
    workgroupBarrier();
    // Position of this member in the order of cells, ties by index; found by counting, since there are only 256 keys.
    var place = 0u;
    for (var other_ix = 0u; other_ix < WG_SIZE; other_ix++) {
        let other = sh_cell[other_ix];
        place += select(0u, 1u, other < cell || (other == cell && other_ix < local_ix));
    }
    sh_member_of_place[place] = local_ix;
    workgroupBarrier();
    add_sorted(is_diffuse, local_ix);
    workgroupBarrier();
}

fn no_shares() -> Shares {
    var shares: Shares;
    shares.cell = vec3u(NO_CELL);
    return shares;
}

// Shares of a surface with shading `f` and gradient `by`.
fn shares_of(f: ptr<function, Shaded>, by: ptr<function, SurfaceGradient>, inverse: f32) -> Shares {
    var shares: Shares;
    let level = (*f).position.level;
    shares.cell = vec3u(
        cell_of(DIFFUSE_LEVEL, (*f).lambert.taps, (*by).irradiance),
        cell_of(level, (*f).level_taps[0], (*by).level[0]),
        cell_of(level + 1u, (*f).level_taps[1], (*by).level[1]),
    );
    shares.weight = array<vec4f, 3>((*f).lambert.taps.weight, (*f).level_taps[0].weight, (*f).level_taps[1].weight);
    shares.by = array<vec3f, 3>((*by).irradiance, (*by).level[0], (*by).level[1]);
    shares.inverse = inverse;
    shares.lights = (*by).lights;
    return shares;
}

// Adds the shares of all members of the workgroup to the three tables; every thread must call it.
fn add_all_shares(local_ix: u32, shares: ptr<function, Shares>) {
    for (var part = 0u; part < 3u; part++) {
        let by = vec4f((*shares).by[part], (*shares).inverse);
        add_shares(part == 0u, local_ix, (*shares).cell[part], (*shares).weight[part], by);
    }
}
