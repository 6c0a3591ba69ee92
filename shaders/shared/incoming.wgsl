// Light that reaches a Gaussian: its visibility of the environment, and the light of other Gaussians. The importer binds
// `model`, `params`, `gathered` (see `measured`; shorter where nothing was measured) and `indirect_basis` (E_j of Eq. 20).
#import generated/parameters
#import measured

struct IncidentLight {
    // Irradiance gathered from other surfaces.
    gathered: vec3f,
    // Radiance from directions in which the environment is blocked.
    blocked: vec3f,
}

fn gathered_vec3(at: u32) -> vec3f {
    return vec3f(gathered[at], gathered[at + 1u], gathered[at + 2u]);
}

fn incident_light(gaussian_ix: u32) -> IncidentLight {
    var out = IncidentLight(vec3f(0.0), vec3f(0.0));
    if model.indirect_form == INDIRECT_LEARNED {
        let first = model.indirect + 16u * gaussian_ix;
        for (var j = 0u; j < 16u; j++) {
            let e = vec3f(indirect_basis[3u * j], indirect_basis[3u * j + 1u], indirect_basis[3u * j + 2u]);
            out.blocked += params[first + j] * e;
        }
    }
    if model.indirect_form == INDIRECT_GATHERED && 6u * gaussian_ix + 6u <= arrayLength(&gathered) {
        out.gathered = gathered_vec3(6u * gaussian_ix);
        out.blocked = gathered_vec3(6u * gaussian_ix + 3u);
    }
    return out;
}

fn visibility_at(gaussian_ix: u32, coefficient_ix: u32) -> f32 {
    if coefficient_ix >= model.n_visibility {
        return 0.0;
    }
    return params[model.visibility + model.n_visibility * gaussian_ix + coefficient_ix];
}

// Group `quad` of the visibility coefficients, zero-padded.
fn visibility_quad(gaussian_ix: u32, quad: u32) -> vec4f {
    let first = 4u * quad;
    return vec4f(
        visibility_at(gaussian_ix, first),
        visibility_at(gaussian_ix, first + 1u),
        visibility_at(gaussian_ix, first + 2u),
        visibility_at(gaussian_ix, first + 3u),
    );
}
