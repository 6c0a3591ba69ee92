// Output of update.wgsl's gradients: an Adam step or, under GRADIENTS, the gradients themselves. The importing kernel declares
// its bindings, the staged values and BLOCK, STRIDE and WG_SIZE.
#import adam
#import finite
#import status

// True when emitting `field` has an effect.
fn trains(field: u32) -> bool {
#ifdef GRADIENTS
    return true;
#else
    return update.rates[field].x != 0.0;
#endif
}

// Emits the gradient of one parameter.
fn emit(element_ix: u32, gradient: f32, field: u32) {
#ifdef GRADIENTS
    gradients[element_ix] = gradient;
    if !is_finite(gradient) {
        atomicOr(&status[STATUS_POISON], POISON_GAUSSIAN);
    }
#else
    let rate = update.rates[field];
    if rate.x == 0.0 {
        return;
    }
    if !is_finite(gradient) {
        atomicOr(&status[STATUS_POISON], POISON_GAUSSIAN);
        return;
    }
    let by = adam(first[element_ix], second[element_ix], gradient, rate.x, rate.y);
    first[element_ix] = by.first;
    second[element_ix] = by.second;
    params[element_ix] -= by.step;
#endif
}

fn emit3(element_ix: u32, gradient: vec3f, field: u32) {
    emit(element_ix, gradient.x, field);
    emit(element_ix + 1u, gradient.y, field);
    emit(element_ix + 2u, gradient.z, field);
}

// Emits `count` staged gradients, at most BLOCK, of each Gaussian of the workgroup that starts at `first_ix`. `start` is the
// element of the first of them for Gaussian 0, `width` the width of the field.
fn emit_block(first_ix: u32, local_ix: u32, start: u32, width: u32, count: u32, field: u32) {
    let n = min(count, BLOCK);
    for (var at = local_ix; at < WG_SIZE * n; at += WG_SIZE) {
        let gaussian_ix = first_ix + at / n;
        let k = at % n;
        if gaussian_ix < model.n {
            emit(start + gaussian_ix * width + k, sh_staged[(BLOCK + k) * STRIDE + at / n], field);
        }
    }
}
