// Elements of the status buffer, `array<atomic<u32>>`.

// Non-zero after a gradient that is not finite.
const STATUS_POISON = 0u;
// Values of STATUS_POISON: gradient by a Gaussian's parameter; by a prototype or texel of the light.
const POISON_GAUSSIAN = 1u;
const POISON_GLOBAL = 2u;
