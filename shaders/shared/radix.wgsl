// Shared code of the two kernels of a radix sort pass: the digit of a key, and the elements of each thread. There are at most
// `SortPass.n` keys; fewer where the device counted fewer.
#import generated/kernels

const WG_SIZE = 256u;
const PER_THREAD = SORT_BLOCK / WG_SIZE;

struct SortPass {
    // Maximum number of keys; memory is allocated for it.
    n: u32,
    n_blocks: u32,
    // Lowest bit of this pass's digit.
    shift: u32,
    // Number of digits, a power of two, at most 256.
    n_digits: u32,
}

fn digit_of(key: u32, sort: SortPass) -> u32 {
    return (key >> sort.shift) & (sort.n_digits - 1u);
}
