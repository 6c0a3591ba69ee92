// Per-Gaussian parameter fields in storage order, as `scene::Field::ALL`.
const FIELD_MEAN = 0u;
const FIELD_LOG_SCALE = 1u;
const FIELD_QUATERNION = 2u;
const FIELD_OPACITY = 3u;
const FIELD_NORMAL = 4u;
const FIELD_METAL = 5u;
const FIELD_ROUGH = 6u;
const FIELD_SHEEN = 7u;
const FIELD_SCORES = 8u;
const FIELD_RESIDUAL = 9u;
const FIELD_VISIBILITY = 10u;
const FIELD_INDIRECT = 11u;
const FIELD_RADIANCE = 12u;
// Radiance coefficients beyond the first, which have a step size of their own.
const FIELD_RADIANCE_REST = 13u;
const N_FIELDS = 14u;
