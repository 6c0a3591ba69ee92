// Slots of the losses buffer; kept in step with `LossSlot` of src/engine/gpu/losses.rs.
const LOSS_PHYSICAL_L1 = 0u;
const LOSS_PHYSICAL_SQUARED = 1u;
const LOSS_PHYSICAL_SSIM = 2u;
const LOSS_RADIANCE_L1 = 3u;
const LOSS_RADIANCE_SQUARED = 4u;
const LOSS_RADIANCE_SSIM = 5u;
const LOSS_COVERAGE = 6u;
const LOSS_DEPTH_NORMAL = 7u;
const LOSS_SMOOTHNESS = 8u;
const LOSS_NEUTRALITY = 9u;
const LOSS_EXPOSURE = 10u;
const LOSS_AGGREGATION = 11u;
const LOSS_RESIDUAL = 12u;
const LOSS_FLATNESS = 13u;
const LOSS_VISIBILITY = 14u;
