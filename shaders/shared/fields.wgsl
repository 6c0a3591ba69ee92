// Per-Gaussian parameter fields in storage order, as `scene::Field::ALL`.
const FIELD_MEAN = 0u;
const FIELD_LOG_SCALE = 1u;
const FIELD_QUATERNION = 2u;
const FIELD_OPACITY = 3u;
const FIELD_NORMAL = 4u;
const FIELD_METAL = 5u;
const FIELD_ROUGH = 6u;
const FIELD_SCORES = 7u;
const FIELD_RESIDUAL = 8u;
const FIELD_VISIBILITY = 9u;
const FIELD_INDIRECT = 10u;
const FIELD_RADIANCE = 11u;
// Radiance coefficients beyond the first, which have a step size of their own.
const FIELD_RADIANCE_REST = 12u;
const N_FIELDS = 13u;
