// Elements of the status buffer, `array<atomic<u32>>`.

// Not 0 once a gradient was not finite.
const STATUS_POISON = 0u;
// In STATUS_POISON: by a Gaussian's parameter, by a prototype or texel of the light.
const POISON_GAUSSIAN = 1u;
const POISON_GLOBAL = 2u;
