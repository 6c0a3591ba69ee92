// What the two kernels of a radix sort pass share: the digit of a key, and who owns which elements. There are at most
// `SortPass.n` keys: fewer where the device counted fewer.
#import generated/kernels

const WG_SIZE = 256u;
const PER_THREAD = SORT_BLOCK / WG_SIZE;

struct SortPass {
    // Most keys; the memory is laid out for as many.
    n: u32,
    n_blocks: u32,
    // Lowest bit of this pass's digit.
    shift: u32,
    // Digits there are, a power of two, at most 256.
    n_digits: u32,
}

fn digit_of(key: u32, sort: SortPass) -> u32 {
    return (key >> sort.shift) & (sort.n_digits - 1u);
}
