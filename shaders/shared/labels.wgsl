// Gaussians with less summed weight in a view get no label from it.
const LEAST_LABEL_WEIGHT = 1e-3;
